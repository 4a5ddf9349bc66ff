"""What the test for setup faults looks at: few samples of each recording, spread over its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.thresholds import (
    FAULT_SAMPLES,
    MOTION_INDEPENDENT_RATE,
    SINGLE_RECORDING_FOLDS,
)
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF, Segment, blocks, low_pass
from gapscope.ident.signals.effective_samples import motion_samples


@dataclass(frozen=True)
class Samples:
    """Samples of a case, M in all, of n joints, in K folds.

    Attributes:
        q, dq, ddq: recorded motion [rad], [rad/s], [rad/s^2], shape (M, n).
        tau: recorded torque after the 12 Hz filter [N m], (M, n).
        edges: row at which each fold begins, and the end, (K + 1,).
        weight: independent samples per row [1].
        load: inertial parameters of the known body on the last link, (M, 10); zeros where there was none.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    edges: tuple[int, ...]
    weight: float
    load: np.ndarray

    @property
    def folds(self) -> list[slice]:
        """The rows of each fold."""
        return [
            slice(a, b) for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)
        ]

    def thinned(self, step: int) -> Samples:
        """Every ``step``-th sample of each fold."""
        rows = [np.arange(f.start, f.stop)[step // 2 :: step] for f in self.folds]
        edges = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
        kept = np.concatenate(rows)
        weight = min(1.0, self.weight * step)
        motion = self.q[kept], self.dq[kept], self.ddq[kept]
        return Samples(
            *motion,
            self.tau[kept],
            tuple(int(e) for e in edges),
            weight,
            self.load[kept],
        )


def sample(recordings: Sequence[list[Segment]]) -> Samples:
    """Samples of the segments of each recording; a single recording is cut into blocks."""
    folds = [list(segments) for segments in recordings]
    if len(folds) == 1:
        folds = [
            [block]
            for segment in folds[0]
            for block in blocks(segment, SINGLE_RECORDING_FOLDS)
        ]
    seconds = sum(
        len(s.motion.t[s.inner]) / s.motion.rate for fold in folds for s in fold
    )
    total = sum(len(s.motion.t[s.inner]) for fold in folds for s in fold)
    step = max(1, -(-total // FAULT_SAMPLES))
    rows = [np.concatenate([_thin(s, step) for s in fold], axis=1) for fold in folds]
    q, dq, ddq, tau = np.concatenate(rows, axis=1)
    edges = np.concatenate([[0], np.cumsum([r.shape[1] for r in rows])])
    load = np.concatenate([_load(s, step) for fold in folds for s in fold])
    return Samples(
        q,
        dq,
        ddq,
        tau,
        tuple(int(e) for e in edges),
        min(1.0, motion_samples(seconds, MOTION_INDEPENDENT_RATE) / len(q)),
        load,
    )


def _thin(segment: Segment, step: int) -> np.ndarray:
    """q, dq, ddq, tau of every ``step``-th sample, shape (4, M, n)."""
    assert segment.torque is not None
    motion = segment.motion
    tau = low_pass(segment.torque, motion.rate, TORQUE_CUTOFF)
    return np.stack([motion.q, motion.dq, motion.ddq, tau])[:, segment.inner][
        :, step // 2 :: step
    ]


def _load(segment: Segment, step: int) -> np.ndarray:
    """Inertial parameters of the known body on the last link for the rows of ``_thin``, shape (M, 10)."""
    rows = len(segment.motion.t[segment.inner][step // 2 :: step])
    return (
        np.zeros((rows, 10))
        if segment.payload is None
        else np.tile(segment.payload.parameters, (rows, 1))
    )
