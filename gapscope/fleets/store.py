"""Results of many cases as Parquet: rows of a diagnosis, parts, and what is there already."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote
from uuid import uuid4

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.diagnosis.document.numbers import numbers_of

# What is kept of a diagnosis: a row for the case, and a row for each number of each effect.


UNKNOWN = "unknown"
"""Robot of a case that cannot be read."""
INTERVAL = 1.96
"""Standard deviations to each side of an interval of 95 %, for normal errors [1]."""

_TIME = pa.timestamp("us", tz="UTC")
_COMMON = {
    "result": pa.string(),
    "case": pa.string(),
    "unit": pa.string(),
    "robot": pa.string(),
    "date": pa.string(),
}
CASES = pa.schema(
    {
        **_COMMON,
        "name": pa.string(),
        "recorded_at": pa.timestamp("s"),
        "joints": pa.list_(pa.string()),
        "finished": _TIME,
        "fingerprint": pa.string(),
        "case_sha256": pa.string(),
        "program_sha256": pa.string(),
        "nominal_sha256": pa.string(),
        "verdict": pa.string(),
        "gap": pa.float64(),
        "excess": pa.float64(),
        "left": pa.float64(),
        "closed": pa.float64(),
        "effects": pa.list_(pa.string()),
        "recorded_seconds": pa.float64(),
        "bytes": pa.int64(),
        "seconds": pa.float64(),
        "processor_seconds": pa.float64(),
        "tries": pa.int32(),
        "error": pa.string(),
        "kept": pa.string(),
    }
)
"""A row for each case; ``docs/fleet.md`` says what the columns mean."""
EFFECTS = pa.schema(
    {
        **_COMMON,
        "nominal_sha256": pa.string(),
        "named": pa.bool_(),
        "effect": pa.string(),
        "joint": pa.int32(),
        "link": pa.int32(),
        "parameter": pa.string(),
        "component": pa.string(),
        "si_unit": pa.string(),
        "value": pa.float64(),
        "std": pa.float64(),
        "low": pa.float64(),
        "high": pa.float64(),
        "probability": pa.float64(),
        "share": pa.float64(),
    }
)
"""A row for each number of an effect on one joint, link or the arm; one without number for an effect that has none."""
PLACE = ["effect", "joint", "link"]
NUMBER = [*PLACE, "parameter", "component"]

Document = Mapping[str, Any]


def gap_columns(document: Document) -> dict[str, Any]:
    """What the row of a case says of its gap; means over the joints of torque NRMSE [1].

    ``gap`` before any effect, ``excess`` of it over the floor, ``left`` of that after the effects.
    """
    floor = _numbers(document["gap"]["before"]["floor"])
    before = _numbers(document["gap"]["before"]["torque_nrmse"])
    after = _numbers(document["gap"]["after"]["torque_nrmse"])
    return {
        "verdict": document["verdict"],
        "gap": _mean(before),
        "excess": _mean(np.maximum(before - floor, 0.0)),
        "left": _mean(np.maximum(after - floor, 0.0)),
        "closed": document["closed"],
        "effects": [entry["effect"] for entry in document["effects"]],
        "recorded_seconds": sum(r["duration"] for r in document["recordings"]),
    }


def effect_rows(document: Document) -> Iterator[dict[str, Any]]:
    """The numbers of all effects, named or possible, with their intervals of 95 %."""
    for section in ("effects", "possible"):
        for entry in document[section]:
            common = {
                "named": section == "effects",
                "probability": entry["probability"],
                "share": entry["share"],
            }
            for number in numbers_of(entry):
                row = {**common, **number._asdict()}
                row["si_unit"] = row.pop("unit")
                if number.value is not None and number.std is not None:
                    row["low"] = number.value - INTERVAL * number.std
                    row["high"] = number.value + INTERVAL * number.std
                yield row


def _numbers(values: Any) -> np.ndarray:
    """Numbers as an array, NaN for null."""
    return np.atleast_1d(np.array(values, dtype=float))


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


# Results as Parquet, by robot and date: added file by file, each whole or not at all.


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
