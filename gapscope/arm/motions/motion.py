"""A motion as the inverse dynamics wants it: positions with their derivatives on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Motion:
    """Joint motion on a uniform time grid, N samples of n joints.

    Attributes:
        t: time [s], shape (N,), uniform.
        q, dq, ddq: position [rad], velocity [rad/s], acceleration [rad/s^2] as the encoders see them, (N, n).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return whole_rate(float((len(self.t) - 1) / (self.t[-1] - self.t[0])))

    def part(self, rows: slice) -> Motion:
        """Some of its samples."""
        return Motion(self.t[rows], self.q[rows], self.dq[rows], self.ddq[rows])


def whole_rate(rate: float) -> float:
    """A rate [Hz] to six digits: rounding of its stamps must not decide how many samples a time has."""
    return float(f"{rate:.6g}")
