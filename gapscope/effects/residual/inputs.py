"""What a residual network sees of a motion: per joint its own signals, what it remembers, the other joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.effects.residual.memory import (
    REACHES,
    STATES,
    WARMING,
    memory_series,
)

SPEEDS = np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
"""Speeds v at which a direction tanh(dq / v) turns [rad/s]."""
DIRECTION = 2
"""The direction that the past of a window and the neighbourhood of the training data are told by."""
OF_OTHERS = 3
"""The direction of the other joints."""


@dataclass(frozen=True)
class Layout:
    """Places of the channels of a joint of an arm with n joints; C = 13 + 7 n of them.

    The joint's dq, ddq and load; its directions; its memory; dq, ddq, load and direction of the others; q, sin q and
    cos q of all joints, its own first.
    """

    n: int

    @property
    def channels(self) -> int:
        """Number C of channels."""
        return self.angle + 3 * self.n

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels in their order; ``other_1`` is the first of the arm's other joints."""
        own = ("velocity", "acceleration", "load")
        directions = [f"direction_{speed:g}" for speed in SPEEDS]
        memory = [f"strain_{reach:g}" for reach in REACHES]
        memory += [f"warmth_{time:g}" for time in WARMING]
        others = [f"other_{k}" for k in range(1, self.n)]
        signals = (*own, f"direction_{SPEEDS[OF_OTHERS]:g}")
        of_others = [f"{signal}_{other}" for signal in signals for other in others]
        angles = ["position", *(f"position_{other}" for other in others)]
        posture = [f"{f}{angle}" for f in ("", "sin_", "cos_") for angle in angles]
        return (*own, *directions, *memory, *of_others, *posture)

    @property
    def direction(self) -> slice:
        """The joint's directions."""
        return slice(3, 3 + len(SPEEDS))

    @property
    def memory(self) -> slice:
        """The joint's memory."""
        return slice(self.direction.stop, self.direction.stop + STATES)

    @property
    def others(self) -> slice:
        """Signals of the other joints: dq, ddq, load and direction, n - 1 each."""
        return slice(self.memory.stop, self.memory.stop + 4 * (self.n - 1))

    @property
    def angle(self) -> int:
        """The joint's position; those of the others follow."""
        return self.others.stop

    @property
    def own(self) -> np.ndarray:
        """Channels of the joint itself."""
        position = self.angle + self.n * np.arange(3)
        return np.concatenate([np.arange(self.memory.stop), position])

    @property
    def past(self) -> np.ndarray:
        """Channels of which a network with a short past sees the past: dq and a direction."""
        return np.array([0, self.direction.start + DIRECTION])

    @property
    def neighbourhood(self) -> np.ndarray:
        """Channels by which the distance from the training data is told: dq, ddq, load, direction, dq, sin q, cos q."""
        own = [0, 1, 2, self.direction.start + DIRECTION]
        others = np.arange(self.others.start, self.others.start + self.n - 1)
        posture = np.arange(self.angle + self.n, self.channels)
        return np.concatenate([own, others, posture]).astype(int)


@dataclass(frozen=True)
class Inputs:
    """Windows of channels, one per joint; see ``Layout``.

    The load is the torque that the corrected arm predicts for the joint [N m]. A window holds ``taps`` samples,
    ``spacing`` apart, the oldest first; before the beginning of a motion the arm is taken to have stood where it
    begins, with the signals of the first sample.

    Attributes:
        n: number of joints.
        taps: samples in a window.
        spacing: time between them [s].
        mean, std: of the channels, in their units, subtracted and divided by; shape (n, C).
    """

    n: int
    taps: int
    spacing: float
    mean: np.ndarray
    std: np.ndarray

    @property
    def layout(self) -> Layout:
        """Places of the channels."""
        return Layout(self.n)

    @property
    def channels(self) -> int:
        """Number C of channels."""
        return self.layout.channels

    @property
    def seen_by_mlp(self) -> np.ndarray:
        """Places in a flat window that the MLP sees: the joint's own channels now, its dq and direction before.

        Signals of all joints let it learn the paths of the training motions instead of functions.
        """
        places = np.arange(self.taps * self.channels).reshape(self.taps, self.channels)
        now = places[-1, self.layout.own]
        return np.concatenate([places[:-1, self.layout.past].ravel(), now])

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
        return self.windows_of(channels(motion, load), motion.rate, rows)

    def windows_of(
        self, series: np.ndarray, rate: float, rows: np.ndarray
    ) -> np.ndarray:
        """The same of channels in their units, (n, N, C), at a rate [Hz]."""
        back = self.spacing * rate * np.arange(self.taps - 1, -1, -1)
        place = np.maximum(rows[:, None] - back, 0.0)
        before = np.floor(place).astype(int)
        part = (place - before)[None, :, :, None]
        after = np.minimum(before + 1, series.shape[1] - 1)
        between = (1.0 - part) * series[:, before] + part * series[:, after]
        scaled = between - self.mean[:, None, None]
        return np.asarray(scaled / self.std[:, None, None])


def channels(motion: Motion, load: np.ndarray) -> np.ndarray:
    """Channels of each joint at each sample, in their units, shape (n, N, C)."""
    memory = memory_series(motion, load)
    return channels_with(memory, motion.q, motion.dq, motion.ddq, load)


def channels_with(
    memory: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
    load: np.ndarray,
) -> np.ndarray:
    """The same with the memory known, (n, N, STATES); the signals are (N, n)."""
    n = q.shape[1]
    direction = np.tanh(dq[:, :, None] / SPEEDS)
    series = (dq, ddq, load, direction[:, :, OF_OTHERS])
    joints = []
    for j in range(n):
        own = np.stack([dq[:, j], ddq[:, j], load[:, j]], axis=1)
        others = [np.delete(x, j, axis=1) for x in series]
        angle = np.hstack([q[:, [j]], np.delete(q, j, axis=1)])
        posture = [angle, np.sin(angle), np.cos(angle)]
        joints.append(np.hstack([own, direction[:, j], memory[j], *others, *posture]))
    return np.stack(joints)
