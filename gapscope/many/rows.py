"""The row of one diagnosis of many: its unit and date, what tables show of it, and rows as Parquet."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote
from uuid import uuid4

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from gapscope.arm.display import effect_name
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.diagnosis.document.numbers import number_rows
from gapscope.diagnosis.document.wording import VERDICTS, acts_on
from gapscope.envs.effect_ranges import Z95
from gapscope.model.changes import change_text

# Unit and date of a diagnosis, by the names of its case and folders.


CASE, FOLDER = "case", "folder"
UNITS_BY = (CASE, FOLDER)
"""What names the unit of a diagnosis: its case, or the folder above it."""
_DATE = re.compile(
    r"""(?<!\d)
    (?P<year>20\d\d)
    (?:(?P<mark>[-_.])(?P<month>\d\d)(?:(?P=mark)(?P<day>\d\d))?   # 2026-03, 2026_03_14
      |(?P<packed>\d{4}))                                          # 20260314
    (?:[T_ -](?P<hour>\d\d)[-_:.]?(?P<minute>\d\d)(?:[-_:.]?(?P<second>\d\d))?)?
    (?!\d)""",
    re.VERBOSE,
)
_MARKS = "-_. "
"""Between a date and the rest of a name."""


def split_date(name: str) -> tuple[datetime | None, str]:
    """The date in a name, and the name without it.

    Args:
        name: of a folder or a case, e.g. ``arm7_2026-03-14``, ``20260314_0930`` or ``2026-03`` (its first day).

    Returns:
        The first date, local time, ``None`` if there is none; the rest of the name, which may be empty.
    """
    for match in _DATE.finditer(name):
        packed = match["packed"] or ""
        # 20260314 has both in one; 2026-03 is its first day
        month, day = match["month"] or packed[:2], match["day"] or packed[2:] or "1"
        hour, minute, second = (match[p] or "0" for p in ("hour", "minute", "second"))
        text = f"{match['year']} {month} {day} {hour} {minute} {second}"
        try:
            date = datetime.strptime(text, "%Y %m %d %H %M %S")
        except ValueError:
            continue  # the calendar does not have it
        rest = (name[: match.start()].strip(_MARKS), name[match.end() :].strip(_MARKS))
        return date, "_".join(filter(None, rest))
    return None, name


def unit_name(case: str, folder: str, units_by: str = CASE) -> str:
    """Name of the unit, without dates.

    Args:
        case: name of the case.
        folder: of the diagnosis, relative to the archive.
        units_by: ``case``: the name of the case; the folder above if that name is a date alone. ``folder``: the nearest
            folder above the diagnosis that is more than a date; its own if there is none.
    """
    above = list(PurePath(folder).parts)
    folders = [*reversed(above[:-1]), *above[-1:]]
    names = [case, *folders] if units_by == CASE else [*folders, case]
    # a name that is a date alone leaves nothing
    rests = (split_date(name)[1] for name in names)
    # only dates: the name of the case is better than none
    return next((rest for rest in rests if rest), case)


def date_in_names(case: str, folder: str) -> datetime | None:
    """The date in the name of the case, or of the nearest folder that has one."""
    # the nearest name first: folders above may date whole series
    names = (case, *reversed(PurePath(folder).parts))
    return next((date for date, _ in map(split_date, names) if date is not None), None)


# One diagnosis of many.


FAILED = "failed"
"""Verdict of a case without a diagnosis, or of a file that cannot be read."""


@dataclass(frozen=True)
class Row:
    """A diagnosis of many: of a run over several cases, below a folder, or of a fleet.

    Attributes:
        case: name of the case; of the folder if there is no diagnosis.
        folder: of its files, relative to the results, with forward slashes; ``.`` for that of the results itself.
        document: content of ``diagnosis.json``, or what is kept of it; ``None`` if there is none.
        problem: why there is none.
        unit: name of the arm that was diagnosed.
        date: local time.
        dated: whether the date is that of a name; otherwise the file's last change.
        has_report: whether ``report.html`` is beside it.
        exit_code: of a command that made it: not 0 if it failed.
    """

    case: str
    folder: str
    document: Mapping[str, Any] | None = None
    problem: str = ""
    unit: str = ""
    date: datetime = datetime.min
    dated: bool = False
    has_report: bool = False
    exit_code: int = 0

    @property
    def label(self) -> str:
        """Name of the case, with its folder if that has another name."""
        return self.case if self.folder == self.case else f"{self.case} ({self.folder})"

    @property
    def link(self) -> str:
        """Relative address of the report."""
        return f"./{quote(self.folder)}/report.html"

    @property
    def date_text(self) -> str:
        """The date, with the time of day unless it is midnight."""
        # a day in a name has no time
        midnight = self.date.time() == datetime.min.time()
        return f"{self.date:%Y-%m-%d}" if midnight else f"{self.date:%Y-%m-%d %H:%M}"

    @property
    def verdict(self) -> str:
        """As in the document, or ``failed``."""
        return FAILED if self.document is None else str(self.document["verdict"])

    @property
    def line(self) -> str:
        """Verdict and effects in a sentence, or why there is no diagnosis."""
        each = (f"{effect_name(one['effect'])}, {acts_on(one)}" for one in self.effects)
        return self.problem or f"{VERDICTS[self.verdict]}. {'; '.join(each)}".strip()

    @property
    def effects(self) -> Sequence[Mapping[str, Any]]:
        """Entries of those named, the largest share first."""
        return (self.document or {}).get("effects", ())

    @property
    def possible(self) -> Sequence[Mapping[str, Any]]:
        """Entries of those possible, not confirmed."""
        return (self.document or {}).get("possible", ())

    @cached_property
    def changes(self) -> tuple[str, ...]:
        """What changed during a recording, in words."""
        found = (self.document or {}).get("changes", ())
        return tuple(change_text(change) for change in found)

    @property
    def closed(self) -> float | None:
        """Share of the gap above the floor that is closed [1]; ``None`` if there is no gap."""
        if self.document is None or self.verdict == "no_gap":
            return None
        return self.document["closed"]

    def gap(self, stage: str, key: str = "torque_nrmse") -> np.ndarray:
        """Torque NRMSE of each joint ``before`` or ``after``, or its ``floor`` before [1], NaN if it is not known."""
        values = [] if self.document is None else self.document["gap"][stage][key]
        return np.atleast_1d(np.array(values, dtype=float))

    def mean_gap(self, stage: str) -> float | None:
        """The same, mean over the joints."""
        return _mean(self.gap(stage))

    def columns(self) -> dict[str, Any]:
        """What the row of a case says in Parquet of its gap; means over the joints of torque NRMSE [1].

        ``gap`` before any effect, ``excess`` of it over the floor, ``left`` of that after the effects.
        """
        assert self.document is not None
        before, floor = self.gap("before"), self.gap("before", "floor")
        return {
            "verdict": self.verdict,
            "gap": _mean(before),
            # joint by joint: one below its floor pays for no other
            "excess": _mean(np.maximum(before - floor, 0.0)),
            "left": _mean(np.maximum(self.gap("after") - floor, 0.0)),
            "closed": self.document["closed"],
            "effects": [entry["effect"] for entry in self.document["effects"]],
            "recorded_seconds": sum(r["duration"] for r in self.document["recordings"]),
        }

    def numbers(self) -> Iterator[dict[str, Any]]:
        """Rows of Parquet: the numbers of all effects, named or possible, with their intervals of 95 %."""
        assert self.document is not None
        for row in number_rows(self.document):
            # in the tables of a fleet a unit is an arm
            row["si_unit"] = row.pop("unit")
            if row["std"] is not None:
                half = Z95 * row["std"]
                row |= {"low": row["value"] - half, "high": row["value"] + half}
            yield row


def _mean(values: np.ndarray) -> float | None:
    # joints that are not known count in no mean
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


# Rows as Parquet, by robot and date: added file by file, each whole or not at all.


UNKNOWN = "unknown"
"""Robot of a case that cannot be read."""
TEXT, NUMERAL, TEXTS = pa.string(), pa.float64(), pa.list_(pa.string())
PARTITION = ("robot", "date")
_COMMON = {
    "result": TEXT,
    "case": TEXT,
    "unit": TEXT,
    "robot": TEXT,
    "date": TEXT,
}
CASES = pa.schema(
    {
        **_COMMON,
        "name": TEXT,
        "recorded_at": pa.timestamp("s"),
        "joints": TEXTS,
        "finished": pa.timestamp("us", tz="UTC"),
        "fingerprint": TEXT,
        "case_sha256": TEXT,
        "program_sha256": TEXT,
        "nominal_sha256": TEXT,
        "verdict": TEXT,
        "gap": NUMERAL,
        "excess": NUMERAL,
        "left": NUMERAL,
        "closed": NUMERAL,
        "effects": TEXTS,
        "recorded_seconds": NUMERAL,
        "bytes": pa.int64(),
        "seconds": NUMERAL,
        "processor_seconds": NUMERAL,
        "tries": pa.int32(),
        "error": TEXT,
        "kept": TEXT,
    }
)
"""A row for each case; ``docs/fleet.md`` says what the columns mean."""
EFFECTS = pa.schema(
    {
        **_COMMON,
        "nominal_sha256": TEXT,
        "named": pa.bool_(),
        "effect": TEXT,
        "joint": pa.int32(),
        "link": pa.int32(),
        "parameter": TEXT,
        "component": TEXT,
        "si_unit": TEXT,
        "value": NUMERAL,
        "std": NUMERAL,
        "low": NUMERAL,
        "high": NUMERAL,
        "probability": NUMERAL,
        "share": NUMERAL,
    }
)
"""A row for each number of an effect on one joint, link or the arm; one without number for an effect that has none."""
PLACE = ["effect", "joint", "link"]
NUMBER = [*PLACE, "parameter", "component"]

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
        # effects first: a case in the table has all of its effects
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
        # these decide which rows count, even if nobody asked for them
        needed = dict.fromkeys([*wanted, "case", "date", "finished", "error"])
        frame = _read(self._cases, CASES, list(needed), where)
        in_time = frame.sort_values("finished", kind="stable")
        latest = in_time.drop_duplicates(["case", "date"], keep="last")
        # a failure counts only until the case is diagnosed, on whatever date
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
        # one robot at a time, so that no more is in memory
        frame = _read(self._effects, EFFECTS, EFFECTS.names, pc.field("robot") == robot)
        frame = frame[frame["result"].isin(results)]
        # written twice if a run ended while it merged files
        return frame.drop_duplicates(["result", "named", *NUMBER])

    def merge(self) -> list[str]:
        """Make one file of the files of each robot and date, without rows that no longer count.

        Returns:
            The folders in which the diagnoses of those rows are kept.
        """
        if not self._cases.is_dir():
            return []
        # which rows count is asked once, over all robots and dates
        kept = self.cases(["result"])["result"]
        every = _read(self._cases, CASES, ["result", "kept"], None)
        for folder, schema in ((self._cases, CASES), (self._effects, EFFECTS)):
            for part in sorted(folder.glob("robot=*/date=*")):
                _merge(part, schema, kept)
        return list(filter(None, every.loc[~every["result"].isin(kept), "kept"]))


def _append(table: pa.Table, folder: Path) -> None:
    keys = table.select(PARTITION).group_by(list(PARTITION)).aggregate([])
    for key in keys.to_pylist():
        # a file for each robot and date, as folders go
        of_robot = pc.equal(table["robot"], key["robot"])
        of_date = pc.equal(table["date"], key["date"])
        rows = table.filter(pc.and_(of_robot, of_date))
        # a name may hold a slash
        names = [f"{name}={quote(key[name], safe='')}" for name in PARTITION]
        _write(rows.drop_columns(list(PARTITION)), folder.joinpath(*names))


def _write(rows: pa.Table, folder: Path) -> Path:
    # a name that no other run can have taken
    path = folder / f"part-{uuid4().hex}.parquet"
    with atomic_write(path) as aside:
        pq.write_table(rows, aside, compression="zstd")
    return path


def _merge(part: Path, schema: pa.Schema, kept: pd.Series) -> None:
    """Make one file of those of a robot and date; the old ones go when the new one is there."""
    old = sorted(part.glob("part-*.parquet"))
    if len(old) < 2:
        return
    # robot and date stand in the names of the folders
    own = pa.schema([field for field in schema if field.name not in PARTITION])
    rows = ds.dataset([str(path) for path in old], schema=own).to_table()
    rows = rows.filter(pc.is_in(rows["result"], value_set=pa.array(kept, pa.string())))
    # then the old ones go: rows that are there twice are told, lost ones are not
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
