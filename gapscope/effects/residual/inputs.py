"""What a residual network sees of a motion: per joint its own signals, the posture, and a short past."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.motions.motion import Motion

SCALED = 4
"""Channels that are scaled, the first: dq, direction, ddq and load of a joint; then dq of the others, also scaled."""
PAST = (0, 1)
"""Of these the MLP sees dq and direction in the past as well."""
DIRECTION = 0.03
"""A joint moves in a direction when it is faster than about this [rad/s]: direction is tanh(dq / DIRECTION)."""


@dataclass(frozen=True)
class Inputs:
    """Windows of channels, one per joint: its dq, direction, ddq and load, dq of the others, sin q and cos q of all.

    The load is the torque that the corrected arm predicts for the joint [N m]. A window holds ``taps`` samples of all
    C = 3 n + 3 channels, ``spacing`` apart, the oldest first; before the beginning of a motion the arm is taken to have
    stood where it begins, with the signals of the first sample.

    Attributes:
        n: number of joints.
        taps: samples in a window.
        spacing: time between them [s].
        mean, std: of the channels, in their units (rad/s, rad/s^2, N m), subtracted and divided by; shape (n, C).
    """

    n: int
    taps: int
    spacing: float
    mean: np.ndarray
    std: np.ndarray

    @property
    def channels(self) -> int:
        """Number C of channels."""
        return 3 * self.n + 3

    @property
    def seen_by_mlp(self) -> np.ndarray:
        """Places in a flat window that the MLP sees: all channels now, and the joint's dq and direction before."""
        places = np.arange(self.taps * self.channels).reshape(self.taps, self.channels)
        return np.concatenate([places[:-1, PAST].ravel(), places[-1]])

    def windows(
        self, motion: Motion, load: np.ndarray, rows: np.ndarray | None = None
    ) -> np.ndarray:
        """Normalised windows at the chosen samples (all of them by default), shape (n, M, taps, C).

        Args:
            motion: N samples of n joints.
            load: torque that the corrected arm predicts [N m], (N, n).
            rows: the samples, (M,).
        """
        rows = np.arange(len(motion.t)) if rows is None else rows
        back = self.spacing * motion.rate * np.arange(self.taps - 1, -1, -1)
        place = np.maximum(rows[:, None] - back, 0.0)
        before = np.floor(place).astype(int)
        part = (place - before)[None, :, :, None]
        seen = (channels(motion, load) - self.mean[:, None]) / self.std[:, None]
        after = np.minimum(before + 1, len(motion.t) - 1)
        return np.asarray((1.0 - part) * seen[:, before] + part * seen[:, after])


def scaled(n: int) -> np.ndarray:
    """Channels that have units and so are scaled, boolean, (3 n + 3,)."""
    return np.arange(3 * n + 3) < SCALED + n - 1


def channels(motion: Motion, load: np.ndarray) -> np.ndarray:
    """Channels of each joint at each sample, in their units, shape (n, N, 3 n + 3)."""
    n = motion.q.shape[1]
    direction = np.tanh(motion.dq / DIRECTION)
    own = np.stack([motion.dq, direction, motion.ddq, load], axis=2)
    posture = np.hstack([np.sin(motion.q), np.cos(motion.q)])
    return np.stack(
        [
            np.hstack([own[:, j], np.delete(motion.dq, j, axis=1), posture])
            for j in range(n)
        ]
    )
