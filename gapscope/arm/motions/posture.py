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
    middle, span = (limits.lower + limits.upper) / 2, limits.upper - limits.lower
    if kinematics.n_joints < 3:
        return middle
    unit = np.random.default_rng(0).uniform(
        -SPREAD, SPREAD, (CANDIDATES, kinematics.n_joints)
    )
    unit[np.random.default_rng(1).random(unit.shape) < 0.5] = 0.0
    scores = [
        _score(kinematics, middle + shift * span) - np.mean(shift**2) / SPREAD**2
        for shift in unit
    ]
    return np.round(middle + unit[int(np.argmax(scores))] * span, 2)


def _score(kinematics: Kinematics, q: np.ndarray) -> float:
    """Tool in front (x over distance), pointing down, neither low nor high, and away from singular postures [1]."""
    position, rotation = kinematics.tool(q)
    jacobian = kinematics.tool_jacobian(q)
    distance = max(float(np.linalg.norm(position)), 1e-9)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    height = abs(position[2] / distance - 0.5)
    return float(
        position[0] / distance
        - rotation[2, 2]
        - height
        + 2 * singular[-1] / max(singular[0], 1e-9)
    )
