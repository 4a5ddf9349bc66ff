"""How far a posture is from a singular one."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.kinematics import Kinematics


def smallest_singular_value(kinematics: Kinematics, q: np.ndarray) -> np.ndarray:
    """Smallest of the min(6, n) singular values of the tool's Jacobian, rows in m/rad and in rad/rad; shape (N,).

    Zero in a singular posture, where the tool cannot move in some direction [nakamura1986].

    Args:
        kinematics: of the arm.
        q: joint positions [rad], shape (N, n).
    """
    jacobians = np.array([kinematics.tool_jacobian(posture) for posture in q])
    small = jacobians if jacobians.shape[2] < 6 else jacobians.transpose(0, 2, 1)
    gram = small.transpose(0, 2, 1) @ small
    return np.sqrt(np.linalg.eigvalsh(gram)[:, 0].clip(0.0))
