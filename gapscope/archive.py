"""The archive: every diagnosis kept as one entry, found again by unit and day, with its history."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path, PurePath
from threading import Lock
from typing import Any

from gapscope.arm.display import effect_name
from gapscope.arm.errors import InputError
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.diagnosis.document.numbers import Number, numbers_of
from gapscope.diagnosis.document.wording import acts_on, parameter_texts
from gapscope.model.changes import change_text

# Dates in the names of folders and cases.


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
        date = _date(match)
        if date is not None:
            parts = (name[: match.start()], name[match.end() :])
            rest = [part.strip(_MARKS) for part in parts]
            return date, "_".join(part for part in rest if part)
    return None, name


def _date(match: re.Match[str]) -> datetime | None:
    """The date of a match; ``None`` if the calendar does not have it."""
    packed = match["packed"] or ""
    month, day = match["month"] or packed[:2], match["day"] or packed[2:] or "1"
    clock = [match[part] or "0" for part in ("hour", "minute", "second")]
    text = f"{match['year']}-{month}-{int(day):02d} {':'.join(clock)}"
    try:
        return datetime.strptime(text, "%Y-%m-%d %H:%M:%S")
    except ValueError:
        return None


# One diagnosis of an archive: what a table and plots over time need of it.


UNREADABLE = "unreadable"
"""Verdict of a diagnosis that cannot be read."""
CASE, FOLDER = "case", "folder"
UNITS_BY = (CASE, FOLDER)
"""What names the unit of a diagnosis: its case, or the folder above it."""


@dataclass(frozen=True)
class ArchivedEffect:
    """An effect of a diagnosis.

    Attributes:
        effect: its readable name.
        acts_on: what it acts on, in words.
        values: its parameters in readable units, a line each; not the number of a link, which ``acts_on`` says.
        share: of the gap [1].
        numbers: all of them; one without a parameter for each place of an effect that has none.
    """

    effect: str
    acts_on: str
    values: tuple[str, ...]
    share: float
    numbers: tuple[Number, ...]


@dataclass(frozen=True)
class Entry:
    """A diagnosis in an archive.

    Attributes:
        folder: relative to the archive, with forward slashes; ``.`` for the archive itself.
        case: name of the case; of the folder if the file cannot be read.
        unit: name of the arm that was diagnosed.
        date: local time.
        dated: whether the date is that of a name; otherwise the file's last change.
        verdict: as in ``diagnosis.json``, or ``unreadable``.
        effects: those named, the largest share first.
        possible: those possible, not confirmed.
        changes: what changed during a recording, in words.
        closed: share of the gap above the floor that is closed [1]; ``None`` without a gap.
        has_report: whether ``report.html`` is beside it.
        problem: why it cannot be read.
    """

    folder: str
    case: str
    unit: str
    date: datetime
    dated: bool
    verdict: str
    effects: tuple[ArchivedEffect, ...] = ()
    possible: tuple[ArchivedEffect, ...] = ()
    changes: tuple[str, ...] = ()
    closed: float | None = None
    has_report: bool = False
    problem: str = ""

    @property
    def date_text(self) -> str:
        """The date, with the time of day unless it is midnight."""
        midnight = (self.date.hour, self.date.minute, self.date.second) == (0, 0, 0)
        return f"{self.date:%Y-%m-%d}" if midnight else f"{self.date:%Y-%m-%d %H:%M}"


def read_entry(
    document: Mapping[str, Any],
    folder: str,
    changed: datetime,
    *,
    units_by: str = CASE,
    has_report: bool = False,
) -> Entry:
    """The entry of a valid document.

    Args:
        document: content of ``diagnosis.json``.
        folder: of the file, relative to the archive.
        changed: when the file was written last.
        units_by: ``case`` or ``folder``.
        has_report: whether ``report.html`` is beside the file.
    """
    case = document["case"]
    date = date_in_names(case, folder)
    return Entry(
        folder,
        case,
        unit_name(case, folder, units_by),
        date or changed,
        date is not None,
        document["verdict"],
        tuple(_effect(entry) for entry in document["effects"]),
        tuple(_effect(entry) for entry in document["possible"]),
        tuple(change_text(change) for change in document.get("changes", [])),
        document["closed"],
        has_report,
    )


def unreadable(folder: str, changed: datetime, problem: str) -> Entry:
    """The entry of a file that is no diagnosis, or not yet."""
    case = PurePath(folder).name
    date = date_in_names("", folder)
    dated = date is not None
    return Entry(folder, case, "", date or changed, dated, UNREADABLE, problem=problem)


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
    rests = (split_date(name)[1] for name in names)
    return next((rest for rest in rests if rest), case)


def date_in_names(case: str, folder: str) -> datetime | None:
    """The date in the name of the case, or of the nearest folder that has one."""
    names = (case, *reversed(PurePath(folder).parts))
    dates = (split_date(name)[0] for name in names)
    return next((date for date in dates if date is not None), None)


def _effect(entry: Mapping[str, Any]) -> ArchivedEffect:
    return ArchivedEffect(
        effect_name(entry["effect"]),
        acts_on(entry),
        tuple(f"{text.name} {text.text}" for text in parameter_texts(entry)),
        float(entry["share"]),
        tuple(numbers_of(entry)),
    )


# All diagnoses below a folder, read again only if their files have changed.


DOCUMENT, REPORT = "diagnosis.json", "report.html"
LARGEST = 50_000_000
"""Files that are larger are no diagnosis, which has some 100 kB [bytes]."""
_OTHER_VERSION = (LookupError, TypeError, ValueError, ArithmeticError)
"""What a document of the schema can still lead to; it must not hide the others."""
_State = tuple[int, int, bool]
"""Time of the last change [ns], size [bytes], and whether there is a report."""


class Archive:
    """The diagnoses below a folder, at any depth.

    Hidden folders and links to folders are not entered. ``entries`` may be called from several threads.
    """

    def __init__(self, root: Path, units_by: str = CASE) -> None:
        """Take a folder; nothing is read yet.

        Raises:
            InputError: it is no folder, or ``units_by`` is neither ``case`` nor ``folder``.
        """
        if units_by not in UNITS_BY:
            raise InputError(f"{units_by} names no unit", "use case or folder")
        if not root.is_dir():
            remedy = "give the folder in which gapscope diagnose wrote its results"
            raise InputError("is not a folder", remedy, file=root)
        self.root = root.resolve()
        self.units_by = units_by
        self._known: dict[Path, tuple[_State, Entry]] = {}
        self._lock = Lock()

    def entries(self, progress: Callable[[str], None] | None = None) -> list[Entry]:
        """All diagnoses as they are now, the latest first."""
        with self._lock:
            known: dict[Path, tuple[_State, Entry]] = {}
            lost: list[Entry] = []
            for file, has_report in self._files(lost):
                known[file] = self._current(file, has_report)
                if progress and len(known) % 100 == 0:
                    progress(f"{len(known)} diagnoses")
            self._known = known
        entries = [entry for _, entry in known.values()] + lost
        return sorted(entries, key=lambda entry: (entry.date, entry.folder))[::-1]

    def _files(self, lost: list[Entry]) -> Iterator[tuple[Path, bool]]:
        """Every ``diagnosis.json``, and whether a report is beside it; folders that cannot be read go to ``lost``."""

        def closed(error: OSError) -> None:
            place = self._place(Path(error.filename))
            lost.append(unreadable(place, datetime.now(), f"folder: {error.strerror}"))

        for folder, folders, files in os.walk(self.root, onerror=closed):
            folders[:] = [name for name in folders if not name.startswith(".")]
            if DOCUMENT in files:
                yield Path(folder, DOCUMENT), REPORT in files

    def _current(self, file: Path, has_report: bool) -> tuple[_State, Entry]:
        """State and entry of a file: those known if it has not changed."""
        try:
            found = file.stat()
        except OSError as error:  # removed just now, or a link that leads nowhere
            problem = f"cannot be read ({error.strerror})"
            lost = unreadable(self._place(file.parent), datetime.now(), problem)
            return (0, 0, has_report), lost
        state = (found.st_mtime_ns, found.st_size, has_report)
        known = self._known.get(file)
        if known and known[0] == state:
            return known
        return state, self._read(file, state)

    def _read(self, file: Path, state: _State) -> Entry:
        nanoseconds, size, has_report = state
        changed = datetime.fromtimestamp(nanoseconds / 1e9)
        place = self._place(file.parent)
        problem = self._refusal(file, size)
        if problem:
            return unreadable(place, changed, problem)
        try:
            document = read_document(file)
            return read_entry(
                document, place, changed, units_by=self.units_by, has_report=has_report
            )
        except InputError as error:
            problem = error.problem
        except RecursionError:
            problem = "is nested too deeply"
        except _OTHER_VERSION as error:
            problem = f"is of another version of Gapscope ({error!r})"
        return unreadable(place, changed, problem)

    def _refusal(self, file: Path, size: int) -> str:
        """Why a file is not read at all; empty if it is."""
        if not file.resolve().is_relative_to(self.root):
            return "is a link that leaves the folder"
        if not file.is_file():
            return "is not a file"
        return "is too large for a diagnosis" if size > LARGEST else ""

    def _place(self, folder: Path) -> str:
        return folder.relative_to(self.root).as_posix()


# Effects of one unit over time.


@dataclass
class EffectHistory:
    """An effect on one place over time.

    Attributes:
        effect: its readable name.
        place: ``joint 4``, ``link 3`` or ``the whole arm``.
        in_time: all diagnoses of the unit, in order of time.
        found: those that name the effect there.
        parameters: by parameter and its unit, then by component, all points in order of time: diagnosis and number.
    """

    effect: str
    place: str
    in_time: Sequence[Entry]
    found: list[Entry] = field(default_factory=list)
    parameters: dict[tuple[str, str], dict[str, list[Point]]] = field(
        default_factory=dict
    )

    def add(self, entry: Entry, number: Number) -> None:
        """Add a number of the effect there."""
        if entry not in self.found[-1:]:
            self.found.append(entry)
        if number.parameter:
            key = number.parameter.replace("_", " "), number.unit
            points = self.parameters.setdefault(key, {})
            points.setdefault(number.component, []).append((entry, number))

    @property
    def span(self) -> tuple[datetime, datetime]:
        """First and last date of the unit's diagnoses."""
        return self.in_time[0].date, self.in_time[-1].date

    @property
    def absent(self) -> list[datetime]:
        """Dates of the diagnoses of the unit that do not name the effect there."""
        folders = {entry.folder for entry in self.found}
        return [entry.date for entry in self.in_time if entry.folder not in folders]


Point = tuple[Entry, Number]


def histories(entries: Iterable[Entry], unit: str) -> list[EffectHistory]:
    """Effects of a unit, those found most often first.

    Args:
        entries: of an archive.
        unit: its name; diagnoses of other units and unreadable ones are left out.
    """
    of_unit = [e for e in entries if e.unit == unit and e.verdict != UNREADABLE]
    in_time = sorted(of_unit, key=lambda entry: (entry.date, entry.folder))
    made: dict[tuple[str, str], EffectHistory] = {}
    for entry in in_time:
        for effect in entry.effects:
            for number in effect.numbers:
                key = effect.effect, number.place
                made.setdefault(key, EffectHistory(*key, in_time)).add(entry, number)
    return sorted(made.values(), key=lambda h: (-len(h.found), h.effect, h.place))
