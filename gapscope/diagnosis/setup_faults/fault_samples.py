"""What the test for setup faults looks at: few samples of each recording, spread over its length."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.diagnosis.gap.excerpt import folds_of
from gapscope.diagnosis.thresholds import (
    FAULT_SAMPLES,
    MOTION_INDEPENDENT_RATE,
    TORQUE_SHIFT_STEP,
    TORQUE_SHIFTS,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass
from gapscope.model.effective_samples import motion_samples


@dataclass(frozen=True)
class FaultSamples:
    """Samples of a case, M in all, of n joints, in K folds.

    Attributes:
        q, dq, ddq: recorded motion [rad], [rad/s], [rad/s^2], shape (M, n).
        later_tau: recorded torque after the 12 Hz filter [N m], at the time of the sample plus each of
            ``TORQUE_SHIFTS``, (S, M, n).
        edges: row at which each fold begins, and the end, (K + 1,).
        weight: independent samples per row [1].
        load: inertial parameters of the known body on the last link, (M, 10); zeros if there was none.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    later_tau: np.ndarray
    edges: tuple[int, ...]
    weight: float
    load: np.ndarray

    @property
    def folds(self) -> list[slice]:
        """The rows of each fold."""
        return [
            slice(a, b) for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)
        ]

    def torque(self, delay: float = 0.0) -> np.ndarray:
        """Recorded torque [N m] at the time of the samples plus a delay [s], (M, n), linear between shifts."""
        place = min(delay / TORQUE_SHIFT_STEP, len(self.later_tau) - 1.0)
        before = int(place)
        after = min(before + 1, len(self.later_tau) - 1)
        share = place - before
        return (1 - share) * self.later_tau[before] + share * self.later_tau[after]

    def thinned(self, step: int) -> FaultSamples:
        """Every ``step``-th sample of each fold."""
        rows = [np.arange(f.start, f.stop)[step // 2 :: step] for f in self.folds]
        kept = np.concatenate(rows)
        return FaultSamples(
            self.q[kept],
            self.dq[kept],
            self.ddq[kept],
            self.later_tau[:, kept],
            _edges([len(r) for r in rows]),
            min(1.0, self.weight * step),
            self.load[kept],
        )


def sample(recordings: Sequence[list[Segment]]) -> FaultSamples:
    """Samples of the segments of each recording, in folds."""
    folds = folds_of(recordings)
    segments = [segment for fold in folds for segment in fold]
    sample_counts = [len(s.motion.t[s.inner]) for s in segments]
    seconds = sum(
        count / s.motion.rate for count, s in zip(sample_counts, segments, strict=True)
    )
    step = max(1, math.ceil(sum(sample_counts) / FAULT_SAMPLES))
    rows = [np.concatenate([_thin(s, step) for s in fold], axis=1) for fold in folds]
    q, dq, ddq = np.concatenate(rows, axis=1)
    later_tau = [_later_torque(s, step) for s in segments]
    return FaultSamples(
        q,
        dq,
        ddq,
        np.concatenate(later_tau, axis=1),
        _edges([r.shape[1] for r in rows]),
        min(1.0, motion_samples(seconds, MOTION_INDEPENDENT_RATE) / len(q)),
        np.concatenate([_load(s, step) for s in segments]),
    )


def _edges(lengths: list[int]) -> tuple[int, ...]:
    """First row of each fold of these lengths, and the end."""
    return (0, *itertools.accumulate(lengths))


def _thin(segment: Segment, step: int) -> np.ndarray:
    """q, dq, ddq of every ``step``-th sample, shape (3, M, n)."""
    motion = segment.motion
    trimmed = np.stack([motion.q, motion.dq, motion.ddq])[:, segment.inner]
    return trimmed[:, step // 2 :: step]


def _later_torque(segment: Segment, step: int) -> np.ndarray:
    """Torque at the times of ``_thin``'s rows plus each of ``TORQUE_SHIFTS``, shape (S, M, n).

    What is trimmed from the end of a segment is longer than the largest shift.
    """
    assert segment.torque is not None
    motion = segment.motion
    tau = low_pass(segment.torque, motion.rate, TORQUE_CUTOFF)
    t = motion.t[segment.inner][step // 2 :: step]
    spline = make_interp_spline(motion.t, tau, k=3)
    return np.stack([spline(t + shift) for shift in TORQUE_SHIFTS])


def _load(segment: Segment, step: int) -> np.ndarray:
    """Inertial parameters of the known body on the last link for the rows of ``_thin``, shape (M, 10)."""
    rows = len(segment.motion.t[segment.inner][step // 2 :: step])
    if segment.payload is None:
        return np.zeros((rows, 10))
    return np.tile(segment.payload.parameters, (rows, 1))
