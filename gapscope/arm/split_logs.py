"""Logs in several files: what a recorder has split, by size or by time, goes on where the file before it ended.

Time of such a file counts from the first row of the first one: friction that fades since the start of a recording goes
on fading, and a force acts when it acts.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from gapscope.arm.recording import Recording

LONGEST_STEP = 4.0
"""Steps of time between two files of one log, at most [1]."""


def joined_in_time(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, in their order; the time of those that go on where another one ended counts from its start."""
    out = list(recordings)
    order = sorted(range(len(out)), key=lambda k: float(out[k].begun + out[k].t[0]))
    for before, after in itertools.pairwise(order):
        one, other = out[before], out[after]
        step = (other.begun + other.t[0]) - (one.begun + one.t[-1])
        if 0.0 < step <= LONGEST_STEP / one.rate:
            later = other.begun - one.begun
            out[after] = replace(other, t=other.t + later, begun=one.begun)
    return out
