"""The MuJoCo engine, of the extra ``mujoco``."""

from __future__ import annotations

import logging
from functools import partial

import mujoco
import numpy as np

from gapscope.arm.dynamics.plain_mjcf import plain_mjcf
from gapscope.arm.dynamics.plain_urdf import Link
from gapscope.envs.engines.engine import RotorEngine

_LOG = logging.getLogger(__name__)
mujoco.set_mju_user_warning(
    _LOG.debug
)  # otherwise warnings are written into a file in the current folder


class MuJoCoEngine(RotorEngine):
    """Rigid bodies in a MuJoCo world of their own.

    Args:
        links: the moving bodies, parents before children.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].
    """

    def __init__(self, links: tuple[Link, ...], gravity: np.ndarray, dt: float) -> None:
        self._model = arm_model(links, gravity, dt)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_setConst(self._model, self._data)
        self._advance = partial(mujoco.mj_step, self._model, self._data)
        self.q, self.dq, self._old_position, self._old_velocity = np.zeros(
            (4, len(links))
        )
        self.position, self.velocity = self._data.qpos, self._data.qvel
        self._force, self._acceleration = self._data.qfrc_applied, self._data.qacc

    def reset(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q [rad or m] with velocities dq."""
        mujoco.mj_resetData(self._model, self._data)
        self.position[:], self.velocity[:] = q, dq
        self.read()

    def step(self, torque: np.ndarray, count: int = 1) -> None:
        """Hold joint torque [N m or N] for ``count`` time steps."""
        self._force[:] = torque
        mujoco.mj_step(self._model, self._data, count)

    def read(self) -> None:
        """Bring ``q`` and ``dq`` up to date."""
        self.q[:], self.dq[:] = self.position, self.velocity

    def set_rotors(self, rotors: np.ndarray) -> None:
        """Use this inertia [kg m^2] on the diagonal of the mass matrix."""
        self._model.dof_armature[:] = rotors

    def advance(self, torque: np.ndarray) -> np.ndarray:
        """One step under joint torque [N m]; the acceleration [rad/s^2] of it, valid until the next call."""
        # twice as fast as numpy.copyto
        self._old_position[...], self._old_velocity[...] = self.position, self.velocity
        self._force[...] = torque
        self._advance()
        return self._acceleration

    def undo(self) -> None:
        """Take the last ``advance`` back; not twice."""
        self.position[...], self.velocity[...] = self._old_position, self._old_velocity

    def close(self) -> None:
        """Nothing outlives the object."""


def arm_model(
    links: tuple[Link, ...], gravity: np.ndarray, dt: float
) -> mujoco.MjModel:
    """The model of an arm; constants that follow from masses are those of bodies of 1 kg until ``mj_setConst``.

    Args:
        links: the moving bodies, parents before children.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].
    """
    model = mujoco.MjModel.from_xml_string(plain_mjcf(links, gravity, dt))
    joints = [model.joint(link.joint) for link in links]
    # bodies are numbered depth first, links parents first; both are the same for arms
    assert [joint.qposadr[0] for joint in joints] == list(range(len(links)))
    for link, joint in zip(links, joints, strict=True):
        body = int(model.jnt_bodyid[joint.id])
        model.body_mass[body] = link.mass
        model.body_inertia[body] = link.moments
    return model
