"""Where a log holds a channel: patterns of column names, units, and the layouts of known logs, which are data."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.constants import centi, degree, kilo, micro, milli, minute, nano

from gapscope.arm.io.table import Table

STEPS_PER_TURN = 4096
"""Encoder steps in a turn of the servos [1]: Feetech STS3215, Dynamixel X series."""

UNITS = {
    "s": 1.0,
    "ms": milli,
    "us": micro,
    "ns": nano,
    "rad": 1.0,
    "deg": degree,
    "rev": 2 * np.pi,
    "step": 2 * np.pi / STEPS_PER_TURN,
    "m": 1.0,
    "mm": milli,
    "rad/s": 1.0,
    "deg/s": degree,
    "rpm": 2 * np.pi / minute,
    "step/s": 2 * np.pi / STEPS_PER_TURN,
    "m/s": 1.0,
    "mm/s": milli,
    "N m": 1.0,
    "mN m": milli,
    "N cm": centi,
    "N": 1.0,
    "kN": kilo,
    "A": 1.0,
    "mA": milli,
    "degC": 1.0,
}
"""Factor from a unit to the one that a recording holds; from a current to A."""


def with_sign(raw: np.ndarray, bit: int) -> np.ndarray:
    """Whole numbers whose bit says the sign of what is below it, as numbers."""
    # 1 if the sign's bit is set, 0 if not
    turned, magnitude = np.divmod(raw, 2.0**bit)
    return np.asarray(np.where(turned == 1, -magnitude, magnitude))


# Patterns of column names: ``{j}`` is the joint's number from 1, ``{j0}`` that from 0, ``{joint}`` its name.


_MARKS = {"{j}": r"(\d+)", "{j0}": r"(\d+)", "{joint}": r"(.+)"}


def name_of(pattern: str, j: int, joint: str) -> str:
    """Name of the column of joint ``j``, from 0."""
    numbered = pattern.replace("{j}", str(j + 1)).replace("{j0}", str(j))
    return numbered.replace("{joint}", joint)


def names_of(pattern: str, joints: Sequence[str]) -> list[str]:
    """Names of the columns of joints; a single one, whose cells hold lists, if the pattern has no mark."""
    if not any(mark in pattern for mark in _MARKS):
        return [pattern]
    return [name_of(pattern, j, joint) for j, joint in enumerate(joints)]


def joints_in(pattern: str, columns: Iterable[str]) -> list[str]:
    """What stands for the joint in the columns that follow a pattern: names, or numbers that count without a gap.

    >>> joints_in("q[{j0}]", ["q[0]", "q[1]", "q[3]"])
    ['0', '1']
    """
    mark = next((mark for mark in _MARKS if mark in pattern), None)
    if mark is None:
        return []
    before, after = pattern.split(mark, 1)
    expression = re.compile(re.escape(before) + _MARKS[mark] + re.escape(after))
    found = [m[1] for m in map(expression.fullmatch, columns) if m]
    if mark == "{joint}":
        return found
    counted: list[str] = []
    # a number stands for a joint only if all before it are there
    while (number := name_of(mark, len(counted), "")) in found:
        counted.append(number)
    return counted


# Known logs, from ``layouts.yaml``: how each is recognised, which column is which channel, what its torque is.


LEROBOT = "LeRobot episode"
"""Kind of the tables of a LeRobot dataset."""


@dataclass(frozen=True)
class Place:
    """Where a layout holds one channel.

    Attributes:
        column: pattern of the column names, as in the import section.
        unit: of the column; empty if it is the recording's.
        holds: what the vendor says that the column holds, if its name does not say it.
    """

    column: str
    unit: str = ""
    holds: str = ""


@dataclass(frozen=True)
class Layout:
    """A known log.

    Attributes:
        name: in words.
        places: by channel, where it may stand; the first that the table has counts.
        source: where this is documented.
        kind: type of messages or format to which it belongs; empty: any table with its columns.
        time: the ``time`` entry of the import section; ``None``: a column ``t`` in s.
        marks: patterns of which the table must have one, if its positions have a name that others use too.
        loads: where the load may stand that the robot was told, as a point: column of its ``mass`` [kg], pattern of the
            columns of its centre, ``com`` [m], and how links are called in whose frame it stands, ``frames``, by the
            endings of their names.
    """

    name: str
    places: Mapping[str, Sequence[Place]]
    source: str
    kind: str = ""
    time: str | Mapping[str, Any] | None = None
    marks: Sequence[str] = ()
    loads: Sequence[Mapping[str, Any]] = ()

    def place(self, channel: str, table: Table) -> Place | None:
        """Where a table of this layout holds a channel, or ``None``."""
        places = self.places.get(channel, ())
        # the first of its places that the table has
        return next((p for p in places if joints_in(p.column, table.columns)), None)

    def fits(self, table: Table) -> bool:
        """Whether a table has the positions, the time and the marks of this layout."""
        entry = self.time
        time = entry.get("column") if isinstance(entry, Mapping) else entry
        # names of positions alone are too common: a mark says whose log it is
        named = [mark for mark in self.marks if joints_in(mark, table.columns)]
        timed = (time or "t") in table.columns
        marked = bool(named) or not self.marks
        return timed and marked and self.place("q", table) is not None


def _layout(places: Mapping[str, Sequence[Any]], **entries: Any) -> Layout:
    """A layout from its entry in ``layouts.yaml``; a place is a pattern, or what more is known of it."""
    found = {
        name: [Place(**p) if isinstance(p, Mapping) else Place(p) for p in each]
        for name, each in places.items()
    }
    return Layout(places=found, **entries)


LAYOUTS = tuple(
    _layout(**entry)
    for entry in yaml.safe_load(
        Path(__file__).with_name("layouts.yaml").read_text(encoding="utf-8")
    )
)
"""All known layouts; of several that fit, the first counts."""


def layout_of_kind(kind: str) -> Layout | None:
    """The layout of a type of messages or a format, or ``None`` for one that has none of its own."""
    return next((layout for layout in LAYOUTS if kind and layout.kind == kind), None)


def layout_of(table: Table) -> Layout | None:
    """The known layout of a table by the kind of its messages, else by its columns; ``None`` of an unknown one."""
    fitting = (layout for layout in LAYOUTS if not layout.kind and layout.fits(table))
    # the type of a message says more than names of columns
    return layout_of_kind(table.kind) or next(fitting, None)
