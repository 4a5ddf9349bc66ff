"""The posture about which an arm moves when nobody names one."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.arm.motions.trajectory import Limits

CANDIDATES = 1000
"""Postures that are compared."""
SPREAD = 0.4
"""They lie within this share of the joints' ranges about the middle [1]."""


def working_posture(kinematics: Kinematics, limits: Limits) -> np.ndarray:
    """Joint positions [rad], shape (n,), with the tool in front of the base, pointing down, free to move.

    The best of fixed candidates about the middle of the limits; an arm of fewer than three joints works in the middle.
    """
    middle = (limits.lower + limits.upper) / 2
    span = limits.upper - limits.lower
    if kinematics.n_joints < 3:
        return middle
    size = (CANDIDATES, kinematics.n_joints)
    shifts = np.random.default_rng(0).uniform(-SPREAD, SPREAD, size)
    # about half of the joints stay in the middle
    shifts[np.random.default_rng(1).random(size) < 0.5] = 0.0
    scores = []
    for shift in shifts:
        distance_from_middle = np.mean(shift**2) / SPREAD**2
        scores.append(_score(kinematics, middle + shift * span) - distance_from_middle)
    best = shifts[int(np.argmax(scores))]
    return np.round(middle + best * span, 2)


def _score(kinematics: Kinematics, q: np.ndarray) -> float:
    """Tool in front (x over distance), pointing down, neither low nor high, and away from singular postures [1]."""
    position, rotation = kinematics.tool(q)
    distance = max(float(np.linalg.norm(position)), 1e-9)
    in_front = position[0] / distance
    upwards = rotation[2, 2]
    height_error = abs(position[2] / distance - 0.5)
    singular = np.linalg.svd(kinematics.tool_jacobian(q), compute_uv=False)
    dexterity = singular[-1] / max(singular[0], 1e-9)
    return float(in_front - upwards - height_error + 2 * dexterity)
