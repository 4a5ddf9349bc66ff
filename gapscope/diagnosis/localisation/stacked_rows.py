"""Segments stacked as rows: the quantities against which a gap is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.model.conditioning import Segment


@dataclass(frozen=True)
class MotionRows:
    """Trimmed samples of several segments, stacked, M rows of n joints.

    Attributes:
        t: time since the start of its recording [s], (M,).
        q, dq, ddq: motion [rad], [rad/s], [rad/s^2], (M, n).
        segment: index of the segment of each row, (M,).
        rates: sampling rate of each segment [Hz].
        names: recording that each segment is a part of; empty if that is not known.
        starts: time at which each segment begins in its recording [s]; empty if all begin at 0.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    segment: np.ndarray
    rates: tuple[float, ...]
    names: tuple[str, ...] = field(default=())
    starts: tuple[float, ...] = field(default=())

    @property
    def clock(self) -> np.ndarray:
        """Time of the recordings' own clocks [s], (M,): a recording may have been cut into several segments."""
        return self.t + np.array(self.starts)[self.segment] if self.starts else self.t

    def recording(self, segment: int) -> str:
        """What the recording of a segment is called."""
        return self.names[segment] if self.names else f"recording {segment + 1}"


def stack(segments: list[Segment]) -> MotionRows:
    """Stack the trimmed samples of segments, in the order in which ``torque_gap`` stacks them."""
    parts = [(s.motion, s.inner) for s in segments]
    lengths = [len(m.t[i]) for m, i in parts]
    return MotionRows(
        t=np.concatenate([m.t[i] - m.t[0] for m, i in parts]),
        q=np.vstack([m.q[i] for m, i in parts]),
        dq=np.vstack([m.dq[i] for m, i in parts]),
        ddq=np.vstack([m.ddq[i] for m, i in parts]),
        segment=np.repeat(np.arange(len(parts)), lengths),
        rates=tuple(m.rate for m, _ in parts),
        names=tuple(s.recording for s in segments),
        starts=tuple(float(m.t[0]) for m, _ in parts),
    )
