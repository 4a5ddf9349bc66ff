"""The observation: the quantities that a controller of the arm has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

FASTEST_OBSERVED = 50.0
"""Bound of observed velocities [rad/s]."""
FURTHEST = 4 * np.pi
"""Bound of observed positions and errors [rad]."""


class Layout:
    """Position of each quantity in the observation, a vector of float32.

    ============== =========== ===== ==================================================================
    name           length      unit  quantity
    ============== =========== ===== ==================================================================
    position       n           rad   encoders, with noise, quantised as the data sheet says
    velocity       n           rad/s estimate from them, see ``gapscope.envs.plant.ControlledArm``
    error          n           rad   reference minus encoders
    action         n or 2 n    1     the action before
    reference      n           rad   position of the reference
    reference_rate n           rad/s its velocity
    look_ahead     n per time  rad   reference at later times minus reference now, first time first
    feedforward    n           1     feedforward torque over the rated torque
    ============== =========== ===== ==================================================================

    What exceeds the bounds of the space is clipped.

    Attributes:
        slices: slice of each quantity, by name.
        measured: slice of the first four, known only once the arm has moved.
        planned: slice of the last four, known from the start.
        space: the observation space.

    Args:
        n_joints: n.
        look_ahead: times at which the reference is observed ahead [s].
        n_actions: numbers in an action; n by default.
    """

    def __init__(
        self, n_joints: int, look_ahead: Sequence[float], n_actions: int | None = None
    ) -> None:
        n = n_joints
        lengths = {
            "position": (n, FURTHEST),
            "velocity": (n, FASTEST_OBSERVED),
            "error": (n, FURTHEST),
            "action": (n if n_actions is None else n_actions, 1.0),
            "reference": (n, FURTHEST),
            "reference_rate": (n, FASTEST_OBSERVED),
            "look_ahead": (n * len(look_ahead), FURTHEST),
            "feedforward": (n, 10.0),
        }
        ends = np.cumsum([length for length, _ in lengths.values()])
        self.slices = {
            name: slice(int(end) - length, int(end))
            for (name, (length, _)), end in zip(lengths.items(), ends, strict=True)
        }
        self.measured, self.planned = (
            slice(0, int(ends[3])),
            slice(int(ends[3]), int(ends[-1])),
        )
        bound = np.repeat(
            [b for _, b in lengths.values()], [length for length, _ in lengths.values()]
        )
        self._high = bound.astype(np.float32)
        self._low = -self._high
        self.space = Box(self._low, self._high, dtype=np.float32)

    @property
    def size(self) -> int:
        """Length of the observation."""
        return self.planned.stop

    def assemble(
        self, measured: tuple[np.ndarray, ...], planned: np.ndarray
    ) -> np.ndarray:
        """The observation from the four measured quantities, and the planned ones in one row; or those of N rows."""
        row = np.concatenate((*measured, planned), axis=-1, dtype=np.float32)
        np.maximum(row, self._low, out=row)
        return np.minimum(row, self._high, out=row)
