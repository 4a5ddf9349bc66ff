"""Results as Parquet, by robot and date: added file by file, each whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote
from uuid import uuid4

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.fleets.rows import CASES, EFFECTS, NUMBER

PARTITION = ("robot", "date")
_HIVE = ds.partitioning(
    pa.schema([(key, pa.string()) for key in PARTITION]), flavor="hive"
)


class FleetStore:
    """The datasets ``cases`` and ``effects`` of a folder.

    Rows are only added. Of the rows of one case and date, the one that was finished last counts; a failure does not if
    the case was diagnosed later. The effects of a row are those with its ``result``. Effects are written before their
    case, so a case that counts has all its effects.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._cases = folder / "cases"
        self._effects = folder / "effects"

    def append(
        self, cases: Sequence[dict[str, Any]], effects: Sequence[dict[str, Any]]
    ) -> None:
        """Add rows, a file for each robot and date.

        Raises:
            GapscopeError: a file cannot be written.
        """
        _append(pa.Table.from_pylist(list(effects), EFFECTS), self._effects)
        _append(pa.Table.from_pylist(list(cases), CASES), self._cases)

    def cases(
        self, columns: Sequence[str] | None = None, where: ds.Expression | None = None
    ) -> pd.DataFrame:
        """The rows of cases that count.

        Args:
            columns: those wanted; all by default.
            where: which rows are read.

        Raises:
            InputError: the folder has no results, or they cannot be read.
        """
        wanted = list(columns or CASES.names)
        needed = dict.fromkeys([*wanted, "case", "date", "finished", "error"])
        frame = _read(self._cases, CASES, list(needed), where)
        in_time = frame.sort_values("finished", kind="stable")
        latest = in_time.drop_duplicates(["case", "date"], keep="last")
        diagnosed = latest[latest["error"] == ""]
        end = latest["case"].map(diagnosed.groupby("case")["finished"].max())
        overcome = (latest["error"] != "") & (latest["finished"] < end)
        return latest.loc[~overcome, wanted]

    def effects(self, robot: str, results: pd.Series) -> pd.DataFrame:
        """The numbers of the effects of some results.

        Args:
            robot: whose.
            results: identifiers of the rows of cases.
        """
        if not self._effects.is_dir():
            return EFFECTS.empty_table().to_pandas()
        frame = _read(self._effects, EFFECTS, EFFECTS.names, pc.field("robot") == robot)
        frame = frame[frame["result"].isin(results)]
        # written twice if a run ended while it merged files
        return frame.drop_duplicates(["result", "named", *NUMBER])

    def merge(self) -> None:
        """Make one file of the files of each robot and date, without rows that no longer count."""
        if not self._cases.is_dir():
            return
        kept = self.cases(["result"])["result"]
        for folder, schema in ((self._cases, CASES), (self._effects, EFFECTS)):
            for part in sorted(folder.glob("robot=*/date=*")):
                _merge(part, schema, kept)


def _append(table: pa.Table, folder: Path) -> None:
    keys = table.select(PARTITION).group_by(list(PARTITION)).aggregate([])
    for key in keys.to_pylist():
        of_robot = pc.equal(table["robot"], key["robot"])
        of_date = pc.equal(table["date"], key["date"])
        rows = table.filter(pc.and_(of_robot, of_date))
        names = [f"{name}={quote(key[name], safe='')}" for name in PARTITION]
        _write(rows.drop_columns(list(PARTITION)), folder.joinpath(*names))


def _write(rows: pa.Table, folder: Path) -> Path:
    path = folder / f"part-{uuid4().hex}.parquet"
    with atomic_write(path) as aside:
        pq.write_table(rows, aside, compression="zstd")
    return path


def _merge(part: Path, schema: pa.Schema, kept: pd.Series) -> None:
    """Make one file of those of a robot and date; the old ones go when the new one is there."""
    old = sorted(part.glob("part-*.parquet"))
    if len(old) < 2:
        return
    own = pa.schema([field for field in schema if field.name not in PARTITION])
    rows = ds.dataset([str(path) for path in old], schema=own).to_table()
    rows = rows.filter(pc.is_in(rows["result"], value_set=pa.array(kept, pa.string())))
    _write(rows, part)
    for path in old:
        path.unlink()


def _read(
    folder: Path, schema: pa.Schema, columns: list[str], where: ds.Expression | None
) -> pd.DataFrame:
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no results are there", "run gapscope fleet with this --out"
        )
    try:
        dataset = ds.dataset(str(folder), schema, format="parquet", partitioning=_HIVE)
        return dataset.to_table(columns=columns, filter=where).to_pandas()
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{folder}: cannot be read ({error})", "remove the damaged file"
        ) from None
