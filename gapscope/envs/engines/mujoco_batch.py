"""Many arms of one structure in MuJoCo, stepped together on threads."""

from __future__ import annotations

import os

import mujoco
import numpy as np
from mujoco.batch import Batch

from gapscope.arm.dynamics.plain_mjcf import quaternion
from gapscope.arm.dynamics.plain_urdf import Link
from gapscope.envs.engines.mujoco import arm_model

FEWEST_PER_THREAD = 32
"""Arms for which it pays to wake another thread: a step of an arm takes 2 to 3 us, waking a thread about 10."""
NO_STAGE = mujoco.mjtStage.mjSTAGE_NONE.value
"""A reset that computes nothing, since positions are written after it."""
FIRST = 1
"""Number of the first moving body: 0 is the world."""


def usable_processors() -> int:
    """Processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class MuJoCoBatch:
    """Rigid bodies of N arms, n joints each in kinematic order; every arm steps as in ``MuJoCoEngine``, bit by bit.

    Masses, inertias, gravity and rotors of each arm can be changed without a model being compiled.

    Args:
        links: the moving bodies of the first arm, parents before children; the others begin as copies of it.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].
        count: N.
        threads: on which they are stepped; 0 for one on every processor that this process may use, as long as each has
            ``FEWEST_PER_THREAD`` arms.

    Attributes:
        position, velocity: present state [rad], [rad/s], shape (N, n); written to move an arm.
        acceleration: of the last step [rad/s^2], shape (N, n); read only.
        rotors: inertia on the diagonal of the mass matrix [kg m^2], shape (N, n); written to change it.
    """

    def __init__(
        self,
        links: tuple[Link, ...],
        gravity: np.ndarray,
        dt: float,
        count: int,
        threads: int = 0,
    ) -> None:
        model = arm_model(links, gravity, dt)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        most = max(1, min(usable_processors(), count // FEWEST_PER_THREAD))
        self._batch = Batch(model, count, min(count, threads or most))
        self.position, self.velocity = (
            self._batch.bind(name) for name in ("qpos", "qvel")
        )
        self.acceleration = self._batch.bind("qacc")
        self._force = self._batch.bind("qfrc_applied")
        self.rotors = self._batch.expand("dof_armature")
        self._bodies: dict[str, np.ndarray] | None = None

    def set_bodies(
        self, number: int, links: tuple[Link, ...], gravity: np.ndarray
    ) -> None:
        """Give an arm, numbered from 0, other bodies of the same structure, and another gravity [m/s^2]."""
        if self._bodies is None:
            names = ("mass", "inertia", "ipos", "iquat", "sameframe", "simple")
            self._bodies = {x: self._batch.expand(f"body_{x}") for x in names}
            self._gravity = self._batch.expand("opt.gravity")
        bodies, moving = self._bodies, slice(FIRST, FIRST + len(links))
        bodies["mass"][number, moving] = [link.mass for link in links]
        bodies["inertia"][number, moving] = [link.moments for link in links]
        bodies["ipos"][number, moving] = [link.inertial[0] for link in links]
        turns = np.array([quaternion(link.inertial) for link in links])
        for turn in turns:
            mujoco.mju_normalize4(turn)
        bodies["iquat"][number, moving] = turns
        bodies["sameframe"][number, moving] = 0
        bodies["simple"][number, moving] = 0
        self._gravity[number] = gravity
        # the constants of a single arm are computed before it gets its rotors
        rotors = self.rotors[number].copy()
        self.rotors[number] = 0.0
        self._batch.set_const([number])
        self.rotors[number] = rotors

    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put an arm at positions q [rad or m] with velocities dq, shape (n,), and forget its past."""
        self._batch.reset([number], stage=NO_STAGE)
        self.position[number], self.velocity[number] = q, dq

    def step(
        self, torque: np.ndarray, count: int = 1, only: np.ndarray | None = None
    ) -> None:
        """Hold joint torque [N m or N] for ``count`` time steps.

        Args:
            torque: shape (N, n), or (k, n) for k arms only.
            count: of time steps.
            only: numbers of the arms that step, sorted, shape (k,); all by default.
        """
        self._force[slice(None) if only is None else only] = torque
        self._batch.step(only, count)
