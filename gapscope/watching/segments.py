"""Samples as they come, cut into overlapping pieces and conditioned as a whole recording would be."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.ident.signals.conditioning import (
    GAP_STEPS,
    SHORTEST,
    TRIM,
    Segment,
    condition,
    pieces,
    position_cutoff,
)
from gapscope.watching.thresholds import BLOCK, FIRST

WINDOW = BLOCK + 2 * TRIM
"""Length of a piece [s]: a block, and what trimming takes from both ends."""
STILL = 1e-3
"""A first motion in which no joint travels farther shows no band [rad]."""


class SegmentStream:
    """Recordings that arrive in parts, as segments of ``WINDOW`` seconds whose trimmed samples follow each other.

    Both ends of a recording lose ``TRIM`` seconds, as they do in a diagnosis. No more than ``FIRST`` seconds of
    samples are held.

    Args:
        cutoff: of the positions [Hz]; ``None``: chosen on the first motion (``position_cutoff``).
        held: samples that were not used yet, from an earlier run.
    """

    def __init__(
        self, cutoff: float | None = None, held: Recording | None = None
    ) -> None:
        self.cutoff = cutoff
        self.held = held

    def add(self, part: Recording) -> Iterator[Segment]:
        """The segments that are complete with the next part of a recording, of this name or a new one.

        Parts without torque end what came before them.
        """
        if self.held is not None and self._breaks(self.held, part):
            yield from self.finish()
        if part.tau is None:
            return
        own = part if self.held is None else _joined(self.held, part)
        length = WINDOW if self.cutoff is not None else FIRST
        while own is not None and own.duration >= length:
            if self.cutoff is None:
                first = own.part(own.t < own.t[0] + FIRST)
                if np.ptp(first.q, axis=0).max() > STILL:
                    self.cutoff = position_cutoff((first,))
                    length = WINDOW
                else:
                    own = own.part(own.t >= own.t[0] + 0.5 * FIRST)
                    continue
            stop = int(np.searchsorted(own.t, own.t[0] + WINDOW, side="left")) + 1
            yield from self._conditioned(own.part(slice(0, stop)))
            own = own.part(own.t >= own.t[0] + BLOCK)
        self.held = own

    def finish(self) -> Iterator[Segment]:
        """The last segment of a recording that has ended, if what is left is long enough."""
        own, self.held = self.held, None
        if own is not None and self.cutoff is not None and own.duration >= 2 * SHORTEST:
            yield from self._conditioned(own)

    def _conditioned(self, piece: Recording) -> Iterator[Segment]:
        assert self.cutoff is not None
        # gaps may leave nothing that is long enough
        if pieces(piece):
            yield from condition(piece, self.cutoff)

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
