"""Effects of one unit over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

from gapscope.archive.entry import UNREADABLE, ArchivedEffect, Entry, Estimate


@dataclass(frozen=True)
class Point:
    """A number at a date; ``entry`` is the diagnosis that it is from."""

    entry: Entry
    estimate: Estimate


class EffectHistory:
    """An effect on one place over time.

    Attributes:
        effect: its readable name.
        place: ``joint 4``, ``link 3`` or ``the whole arm``.
        span: first and last date of the unit's diagnoses.
        found: diagnoses that name the effect there, in order of time.
        parameters: by parameter and its unit, then by component, all points in order of time.
    """

    def __init__(self, effect: str, place: str, in_time: Sequence[Entry]) -> None:
        self.effect, self.place = effect, place
        self.found: list[Entry] = []
        self.parameters: dict[tuple[str, str], dict[str, list[Point]]] = {}
        self.span = (in_time[0].date, in_time[-1].date)
        self._in_time = in_time

    def add(self, entry: Entry, effect: ArchivedEffect) -> None:
        """Add what a diagnosis says of the effect."""
        self.found.append(entry)
        for estimate in effect.estimates:
            if estimate.place == self.place:
                key = (estimate.parameter, estimate.unit)
                by_component = self.parameters.setdefault(key, {})
                points = by_component.setdefault(estimate.component, [])
                points.append(Point(entry, estimate))

    @property
    def absent(self) -> list[datetime]:
        """Dates of the diagnoses of the unit that do not name the effect there."""
        folders = {entry.folder for entry in self.found}
        return [entry.date for entry in self._in_time if entry.folder not in folders]


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
            for place in effect.places:
                blank = EffectHistory(effect.effect, place, in_time)
                history = made.setdefault((effect.effect, place), blank)
                history.add(entry, effect)
    return sorted(made.values(), key=lambda h: (-len(h.found), h.effect, h.place))
