"""What a joint remembers of its motion: how far it came since it last turned, and how warm its torque made it."""

from __future__ import annotations

import numpy as np

from gapscope.arm.motions.motion import Motion

REACHES = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
"""Ways after a reversal over which the stop operators fill [rad]."""
WARMING = np.array([2.0, 6.0, 20.0])
"""Time constants of the warming states [s]."""
STATES = len(REACHES) + len(WARMING)
"""States of a joint."""


class Memory:
    """Stop operators and warming states of n joints, cold and unstrained when the motion begins.

    A stop operator follows the way and is held at its reach r, s = clip(s + dq dt, -r, r): sums of them describe any
    hysteresis of Prandtl and Ishlinskii. A warming state follows the square of the load, T h' = load^2 - h.

    Args:
        q: position at the beginning [rad], (n,).
    """

    def __init__(self, q: np.ndarray) -> None:
        self._q = q
        self._stop: np.ndarray = np.zeros((len(q), len(REACHES)))
        self._heat: np.ndarray = np.zeros((len(q), len(WARMING)))

    def advance(self, q: np.ndarray, load: np.ndarray, dt: float) -> np.ndarray:
        """The states after a sample: stop operators over their reach [1], then warmth [N^2 m^2]; (n, STATES).

        Args:
            q: position [rad], (n,).
            load: torque that the corrected arm predicts [N m], (n,).
            dt: time since the sample before [s].
        """
        way = (q - self._q)[:, None]
        self._q = q
        self._stop = np.clip(self._stop + way, -REACHES, REACHES)
        share = -np.expm1(-dt / WARMING)
        self._heat = self._heat + share * ((load**2)[:, None] - self._heat)
        return np.hstack([self._stop / REACHES, self._heat])


def memory_series(motion: Motion, load: np.ndarray) -> np.ndarray:
    """States along a motion, (n, N, STATES); ``load`` in N m, (N, n)."""
    memory, dt = Memory(motion.q[0]), 1.0 / motion.rate
    states = [memory.advance(q, x, dt) for q, x in zip(motion.q, load, strict=True)]
    return np.stack(states, axis=1)
