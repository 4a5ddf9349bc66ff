"""States of an arm: effects that it has in some recordings only, or between two times of one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gapscope.effects.applied import AppliedEffect


@dataclass(frozen=True)
class Place:
    """Where something holds.

    Attributes:
        recordings: names.
        start, end: times between which it holds, by a recording's own clock [s]; infinite if it is all of it.
    """

    recordings: tuple[str, ...]
    start: float = -np.inf
    end: float = np.inf

    def holds(self, recording: str, start: float, end: float) -> bool:
        """Whether it holds in all of a span of a recording."""
        return recording in self.recordings and self.start <= start and end <= self.end


@dataclass(frozen=True)
class State:
    """All effects that an arm has at a place.

    Attributes:
        place: where.
        effects: the effects, those that it has everywhere among them.
    """

    place: Place
    effects: tuple[AppliedEffect, ...]


Entry = tuple[AppliedEffect, Place | None]
"""An effect, and where the arm has it; ``None`` for everywhere."""


def states_of(entries: Sequence[Entry], order: Sequence[str] = ()) -> tuple[State, ...]:
    """The states that entries make, each of a span of a recording, in which all hold or none.

    Args:
        entries: effects and where they hold.
        order: names of recordings in the order in which they were made; those that are not named there come first.
    """
    named = [name for _, place in entries if place for name in place.recordings]
    if not named:
        return ()
    others = (name for name in named if name not in order)
    every = dict.fromkeys([*others, *order])
    return tuple(state for name in every for state in _of_recording(name, entries))


def _of_recording(name: str, entries: Sequence[Entry]) -> Iterator[State]:
    """The states of a recording, one after the other."""
    places = [place for _, place in entries if place and name in place.recordings]
    times = {-np.inf, np.inf, *(t for p in places for t in (p.start, p.end))}
    for start, end in pairwise(sorted(times)):
        some = (e for e, p in entries if p is None or p.holds(name, start, end))
        yield State(Place((name,), start, end), tuple(some))
