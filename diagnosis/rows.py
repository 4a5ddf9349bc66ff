"""Segments stacked as rows: the quantities against which a gap is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.conditioning import Segment


@dataclass(frozen=True)
class Rows:
    """Trimmed samples of several segments, stacked, M rows of n joints.

    Attributes:
        t: time since the start of its recording [s], (M,).
        q, dq, ddq: motion [rad], [rad/s], [rad/s^2], (M, n).
        segment: index of the segment of each row, (M,).
        rates: sampling rate of each segment [Hz].
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    segment: np.ndarray
    rates: tuple[float, ...]


def stack(segments: list[Segment]) -> Rows:
    """Stack the trimmed samples of segments, in the order in which ``torque_gap`` stacks them."""
    parts = [(s.motion, s.inner) for s in segments]
    lengths = [len(m.t[i]) for m, i in parts]
    return Rows(
        t=np.concatenate([m.t[i] - m.t[0] for m, i in parts]),
        q=np.vstack([m.q[i] for m, i in parts]),
        dq=np.vstack([m.dq[i] for m, i in parts]),
        ddq=np.vstack([m.ddq[i] for m, i in parts]),
        segment=np.repeat(np.arange(len(parts)), lengths),
        rates=tuple(m.rate for m, _ in parts),
    )
