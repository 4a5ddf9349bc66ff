"""Layouts of known logs, as data: how each is recognised, which column is which channel, and what its torque is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from gapscope.arm.io.channel_entry import joints_in
from gapscope.arm.io.table import Table
from gapscope.arm.recording import CHANNELS

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

    def joints(self, table: Table) -> list[str]:
        """Names or numbers of the joints for which the table has the column."""
        return joints_in(self.column, table.columns)

    def entry(self) -> str | dict[str, str]:
        """The entry of the import section."""
        return {"column": self.column, "unit": self.unit} if self.unit else self.column


@dataclass(frozen=True)
class LoadPlace:
    """Where a layout holds the load that a robot was told to carry, as a point.

    Attributes:
        mass: column of its mass [kg].
        com: pattern of the columns of its centre [m].
        frames: how links are called in whose frame the centre stands, by the endings of their names.
    """

    mass: str
    com: str
    frames: tuple[str, ...]


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
        loads: where the load may stand that the robot was told.
    """

    name: str
    places: Mapping[str, Sequence[Place]]
    source: str
    kind: str = ""
    time: str | Mapping[str, Any] | None = None
    marks: Sequence[str] = ()
    loads: tuple[LoadPlace, ...] = ()

    def place(self, channel: str, table: Table) -> Place | None:
        """Where a table of this layout holds a channel, or ``None``."""
        places = self.places.get(channel, ())
        return next((place for place in places if place.joints(table)), None)

    def fits(self, table: Table) -> bool:
        """Whether a table has the positions, the time and the marks of this layout."""
        column = self.time
        if isinstance(column, Mapping):
            column = column.get("column")
        marked = [mark for mark in self.marks if joints_in(mark, table.columns)]
        timed = (column or "t") in table.columns
        named = bool(marked) or not self.marks
        return timed and named and self.place("q", table) is not None

    def channels(self, table: Table) -> dict[str, Place]:
        """The channels that a table of this layout holds."""
        found = {name: self.place(name, table) for name in CHANNELS}
        return {name: place for name, place in found.items() if place is not None}

    def section(self, table: Table) -> dict[str, Any]:
        """The import section for a table of this layout; amperes still lack their motor constants."""
        section: dict[str, Any] = {} if self.time is None else {"time": self.time}
        for name, place in self.channels(table).items():
            section[name] = place.entry()
        return section


def _places(entries: Mapping[str, Sequence[Any]]) -> dict[str, tuple[Place, ...]]:
    """Places by channel, each a pattern or what more is known of it."""
    return {
        name: tuple(
            Place(**entry) if isinstance(entry, Mapping) else Place(entry)
            for entry in places
        )
        for name, places in entries.items()
    }


def _layout(
    places: Mapping[str, Any], loads: Sequence[Any] = (), **entries: Any
) -> Layout:
    """A layout from its entry in ``layouts.yaml``."""
    found = tuple(
        LoadPlace(load["mass"], load["com"], tuple(load["frames"])) for load in loads
    )
    return Layout(places=_places(places), loads=found, **entries)


LAYOUTS: tuple[Layout, ...] = tuple(
    _layout(**entry)
    for entry in yaml.safe_load(
        Path(__file__).with_name("layouts.yaml").read_text(encoding="utf-8")
    )
)
"""All known layouts; of several that fit, the first counts."""


def layout_of_kind(kind: str) -> Layout | None:
    """The layout of a type of messages or a format, or ``None`` for one that has none of its own."""
    return next((layout for layout in LAYOUTS if kind and layout.kind == kind), None)


def layout_of(table: Table, kind: str = "") -> Layout | None:
    """The known layout of a table, or ``None``.

    Args:
        table: the columns of the log.
        kind: type of its messages or format, ``LogTable.kind``.
    """
    own = layout_of_kind(kind)
    if own is not None:
        return own
    for layout in LAYOUTS:
        if not layout.kind and layout.fits(table):
            return layout
    return None
