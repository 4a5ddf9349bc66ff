"""Samples as they come, cut into overlapping pieces and conditioned as a whole recording would be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.model.conditioning import (
    GAP_STEPS,
    TRIM,
    Segment,
    condition,
    pieces,
    position_cutoff,
    slips,
    thinned,
)
from gapscope.model.rows import MODEL_RATE

BLOCK = 2.0
"""Samples are conditioned in blocks of this length [s]. (budget)"""
FIRST = 10.0
"""The cut-off of the positions is chosen on this much of the first motion [s]. (budget)"""
WINDOW = BLOCK + 2 * TRIM
"""Length of a piece [s]: a block, and what trimming takes from both ends."""
LEAST_LEFT = 2.0
"""The end of a recording is used if this much of it is left [s]."""
STILL = 1e-3
"""A first motion in which no joint travels farther shows no band [rad]."""


@dataclass(frozen=True)
class Slip:
    """An encoder that slipped: its reading jumped, and stays off.

    Attributes:
        recording: in which.
        before, after: times of the samples on both sides [s].
        joint: from 1.
        size, error: of the jump, and its standard deviation [rad or m].
    """

    recording: str
    before: float
    after: float
    joint: int
    size: float
    error: float


class SegmentStream:
    """Recordings that arrive in parts, as segments of ``WINDOW`` seconds whose trimmed samples follow each other.

    An encoder that slips is told, and what it slipped by is taken out of all that follows.

    Both ends of a recording lose ``TRIM`` seconds, as they do in a diagnosis. Of a recording
    that comes in small parts no more than ``FIRST`` seconds are held.

    Args:
        cutoff: of the positions [Hz], the largest that a motion asked for so far (``position_cutoff``).
        held: samples that were not used yet, from an earlier run.
        slipped: by how much encoders have slipped so far [rad or m], (n,), or 0.
    """

    def __init__(
        self,
        cutoff: float | None = None,
        held: Recording | None = None,
        slipped: np.ndarray | float = 0.0,
    ) -> None:
        self.cutoff, self.held, self.slipped = cutoff, held, slipped

    def add(self, part: Recording) -> Iterator[Segment | Slip]:
        """The segments that are complete with the next part of a recording, of this name or a new one.

        Parts without torque end what came before them.
        """
        if self.held is not None and self._breaks(self.held, part):
            yield from self.finish()
        if part.tau is None:
            return
        part = replace(part, q=part.q - self.slipped)
        own = part if self.held is None else _joined(self.held, part)
        if self.cutoff is None:
            own = self._from_motion_on(own)
        self.held = own
        if self.cutoff is not None:
            yield from self._windows(own, WINDOW)

    def finish(self) -> Iterator[Segment | Slip]:
        """The last segments of a recording that has ended, if what is left is long enough."""
        own, self.held = self.held, None
        if own is None or own.duration < LEAST_LEFT:
            return
        if self.cutoff is not None or self._chosen(own):
            yield from self._windows(own, LEAST_LEFT)
            self.held = None

    def _windows(self, own: Recording, least: float) -> Iterator[Segment | Slip]:
        """Segments of windows that begin ``BLOCK`` seconds after each other while ``least`` seconds are left."""
        first = 0
        while own.t[-1] - own.t[first] >= least:
            begin = own.t[first]
            stop = int(np.searchsorted(own.t, begin + WINDOW)) + 1
            following = int(np.searchsorted(own.t, begin + BLOCK))
            for jump in slips(own.part(slice(first, stop))):
                k = first + jump.sample
                before, after = float(own.t[k - 1]), float(own.t[k])
                yield Slip(
                    own.name, before, after, jump.joint + 1, jump.size, jump.error
                )
                gone = np.zeros(own.q.shape[1])
                gone[jump.joint] = jump.size
                self.slipped = self.slipped + gone
                late = np.arange(len(own.t)) >= k
                own = replace(own, q=own.q - gone * late[:, None])
            piece = own.part(slice(first, stop))
            first = min(following, len(own.t) - 1)
            yield from self._conditioned(piece)
        self.held = own.part(slice(first, None))

    def _from_motion_on(self, own: Recording) -> Recording:
        """What is left of the first samples when those before a motion are dropped; the cut-off is chosen on it."""
        while own.duration >= FIRST:
            first = own.part(own.t < own.t[0] + FIRST)
            if self._chosen(first):
                break
            own = own.part(own.t >= own.t[0] + 0.5 * FIRST)
        return own

    def _chosen(self, first: Recording) -> bool:
        """Whether the cut-off could be chosen on the first motion."""
        if np.ptp(first.q, axis=0).max() <= STILL:
            return False
        self.cutoff = position_cutoff((first,))
        return True

    def _conditioned(self, piece: Recording) -> Iterator[Segment]:
        assert self.cutoff is not None
        # gaps may leave nothing that is long enough
        if pieces(piece):
            # a motion may be faster than all before it
            self.cutoff = max(self.cutoff, position_cutoff((piece,)))
            for segment in condition(piece, self.cutoff):
                yield thinned(segment, MODEL_RATE)

    @staticmethod
    def _breaks(held: Recording, part: Recording) -> bool:
        """Whether a part does not go on where the samples before it end."""
        if part.tau is None or part.name != held.name or len(held.t) < 2:
            return True
        step = float(part.t[0] - held.t[-1])
        return not 0 < step <= max(GAP_STEPS / held.rate, 0.1)


def _joined(held: Recording, part: Recording) -> Recording:
    """Two parts of a recording, one after the other: time, positions and torque; turns between them taken back."""
    assert held.tau is not None and part.tau is not None
    turns = 2 * np.pi * np.round((part.q[0] - held.q[-1]) / (2 * np.pi))
    return Recording(
        name=held.name,
        t=np.concatenate([held.t, part.t]),
        q=np.concatenate([held.q, part.q - turns]),
        tau=np.concatenate([held.tau, part.tau]),
        payload=held.payload,
    )
