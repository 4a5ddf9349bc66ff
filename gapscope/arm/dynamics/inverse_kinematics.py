"""Inverse kinematics: the joint positions that bring the tool to a pose."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.kinematics import Kinematics, Pose
from gapscope.arm.errors import GapscopeError

TURN = 0.3
"""Length that weighs a turn against a shift: 1 rad counts as much as this many metres [m]."""
TOLERANCE = 1e-7
"""Largest error of the tool that counts as reached [m]."""
LONGEST_STEP = 0.2
"""Joints move by at most this per iteration [rad]."""


def inverse_kinematics(
    kinematics: Kinematics,
    target: Pose,
    start: np.ndarray,
    *,
    turns: bool = True,
    damping: float = 1e-4,
    iterations: int = 100,
) -> np.ndarray:
    """Joint positions [rad], shape (n,), by damped least squares: dq = J^T (J J^T + lambda E)^-1 e [nakamura1986].

    e stacks the shift to the target and the turn to it times ``TURN`` [m]; lambda falls with the error, as
    ``damping`` times e^T e [sugihara2011], so that the last steps are those of Newton.

    Args:
        kinematics: of the arm.
        target: pose of the tool in the base frame.
        start: joint positions to start from [rad], shape (n,); of several solutions a near one is found.
        turns: whether the orientation counts too; an arm of fewer than six joints cannot choose it.
        damping: lambda over e^T e [1]; larger is safer near a singularity, and slower.
        iterations: before giving up.

    Raises:
        GapscopeError: the target was not reached.
    """
    q = np.array(start, dtype=float)
    rows = 6 if turns else 3
    weight = np.repeat([1.0, TURN], 3)[:rows]
    for _ in range(iterations):
        error = _error(kinematics.tool(q), target)[:rows] * weight
        if np.abs(error).max() < TOLERANCE:
            return q
        jacobian = kinematics.tool_jacobian(q)[:rows] * weight[:, None]
        # vanishes with the error, so that the last steps are those of Newton
        lambda_ = damping * error @ error + 1e-12
        regularised = jacobian @ jacobian.T + lambda_ * np.eye(rows)
        step = jacobian.T @ np.linalg.solve(regularised, error)
        longest = max(float(np.abs(step).max()), 1e-12)
        q += step * min(1.0, LONGEST_STEP / longest)
    raise GapscopeError(
        f"the tool cannot reach {np.round(target.position, 3).tolist()} m: {np.linalg.norm(error):.2g} m away",
        "choose a target nearer to the base, or start from another posture",
    )


def _error(pose: Pose, target: Pose) -> np.ndarray:
    """Shift [m] and turn [rad] from a pose to the target along the base's axes, shape (6,)."""
    turn = pin.log3(target.rotation @ pose.rotation.T)
    return np.concatenate([target.position - pose.position, turn])
