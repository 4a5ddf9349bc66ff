"""One diagnosis of an archive: what a table and plots over time need of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePath
from typing import Any

import numpy as np

from gapscope.archive.dates import split_date
from gapscope.arm.display import effect_name
from gapscope.diagnosis.document.wording import acts_on, parameter_texts
from gapscope.model.change_findings import change_text

UNREADABLE = "unreadable"
"""Verdict of a diagnosis that cannot be read."""
CASE, FOLDER = "case", "folder"
UNITS_BY = (CASE, FOLDER)
"""What names the unit of a diagnosis: its case, or the folder above it."""


@dataclass(frozen=True)
class Estimate:
    """One number of an effect.

    Attributes:
        place: ``joint 4``, ``link 3`` or ``the whole arm``.
        parameter: its name.
        component: ``x``, ``y`` or ``z`` of a vector, else empty.
        unit: SI unit of ``value`` and ``std``.
        value: as in ``diagnosis.json``.
        std: its standard deviation, ``None`` if not known.
    """

    place: str
    parameter: str
    component: str
    unit: str
    value: float
    std: float | None


@dataclass(frozen=True)
class ArchivedEffect:
    """An effect of a diagnosis.

    Attributes:
        effect: its readable name.
        acts_on: what it acts on, in words.
        places: each joint by itself, or the link or the arm.
        values: its parameters in readable units, a line each; not the number of a link, which ``acts_on`` says.
        share: of the gap [1].
        estimates: all its numbers.
    """

    effect: str
    acts_on: str
    places: tuple[str, ...]
    values: tuple[str, ...]
    share: float
    estimates: tuple[Estimate, ...]


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
    words = acts_on(entry)
    texts = (text for text in parameter_texts(entry) if text.name != "link")
    joints = tuple(f"joint {joint}" for joint in entry["joints"])
    return ArchivedEffect(
        effect_name(entry["effect"]),
        words,
        joints or (words,),
        tuple(f"{text.name} {text.text}" for text in texts),
        float(entry["share"]),
        tuple(_estimates(entry, joints, words)),
    )


def _estimates(
    entry: Mapping[str, Any], joints: tuple[str, ...], words: str
) -> Iterator[Estimate]:
    """The numbers of an effect one by one; the number of a link is its place, not an estimate."""
    for name, parameter in entry["parameters"].items():
        if name == "link":
            continue
        values = np.atleast_1d(parameter["value"])
        stds = np.broadcast_to(np.array(parameter["std"], float), values.shape)
        units = parameter.get("units") or [parameter["unit"]] * len(values)
        vector = not joints and len(values) == 3
        for k, (value, std) in enumerate(zip(values, stds, strict=True)):
            yield Estimate(
                joints[k] if joints else words,
                name.replace("_", " "),
                "xyz"[k] if vector else "",
                units[k],
                float(value),
                float(std) if np.isfinite(std) else None,
            )
