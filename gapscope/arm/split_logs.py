"""Logs in several files: what a recorder has split, by size or by time, goes on where the file before it ended.

Time of such a file counts from the first row of the first one: friction that fades since the start of a recording goes
on fading, and a force acts when it acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gapscope.arm.recording import Recording

LONGEST_STEP = 4.0
"""Steps of time between two files of one log, at most [1]."""


def joined_in_time(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, in their order; the time of those that go on where another one ended counts from its start."""
    out = list(recordings)
    # what came before a file has its final time by then
    for after in sorted(range(len(out)), key=lambda k: float(out[k].stamps[0])):
        other = out[after]
        ended = [one for one in out if _goes_on(one, other)]
        if ended:
            later = other.begun - ended[0].begun
            out[after] = replace(other, t=other.t + later, begun=ended[0].begun)
    return out


def _goes_on(one: Recording, other: Recording) -> bool:
    """Whether a recording begins where another one ended, by the clock of both."""
    step = (other.begun + other.t[0]) - (one.begun + one.t[-1])
    return bool(0.0 < step <= LONGEST_STEP / one.rate)
