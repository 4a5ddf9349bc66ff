"""Rigid bodies by MuJoCo, of a URDF text."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

GRAVITY = 9.81
"""[m/s^2]."""


def model_of(urdf: str) -> Any:
    """MuJoCo model of an arm on a fixed base, without contacts, limits, friction and armature."""
    model = mujoco.MjModel.from_xml_string(urdf)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.dof_damping[:] = 0
    model.dof_frictionloss[:] = 0
    model.dof_armature[:] = 0
    model.opt.gravity[:] = [0.0, 0.0, -GRAVITY]
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    return model


def inverse_dynamics(
    model: Any, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
) -> np.ndarray:
    """Torque of the rigid bodies [N m], (N, n); q [rad], dq [rad/s], ddq [rad/s^2] of shape (N, n)."""
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:] = q[k]
        data.qvel[:] = dq[k]
        data.qacc[:] = ddq[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def inertia_diagonal(model: Any, q: np.ndarray) -> np.ndarray:
    """Diagonal of the mass matrix [kg m^2] at each posture q [rad] of shape (N, n); (N, n)."""
    out = np.empty_like(q)
    rest = np.zeros_like(q)
    gravity = inverse_dynamics(model, q, rest, rest)
    for j in range(model.nv):
        unit = np.zeros_like(q)
        unit[:, j] = 1.0
        accelerated = inverse_dynamics(model, q, rest, unit)
        out[:, j] = accelerated[:, j] - gravity[:, j]
    return out


def tip_path(model: Any, q: np.ndarray) -> np.ndarray:
    """Centre of mass of the last link in the world [m], (N, 3), at postures q [rad], (N, n)."""
    data = mujoco.MjData(model)
    tip = tip_body(model)
    out = np.empty((len(q), 3))
    for k in range(len(q)):
        data.qpos[:] = q[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        out[k] = data.xipos[tip]
    return out


def tip_body(model: Any) -> int:
    """Index of the body that the last joint moves."""
    return int(model.jnt_bodyid[-1])
