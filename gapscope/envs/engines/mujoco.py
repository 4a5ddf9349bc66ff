"""The MuJoCo engine: one arm, or many of one structure that are stepped together on threads."""

from __future__ import annotations

import logging
import os

import mujoco
import numpy as np
from mujoco.batch import Batch

from gapscope.arm.dynamics.plain_urdf import (
    Link,
    moving_links,
    plain_mjcf,
    quaternion,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.envs.engines import Bodies

_LOG = logging.getLogger(__name__)
mujoco.set_mju_user_warning(
    _LOG.debug
)  # otherwise warnings are written into a file in the current folder

FEWEST_PER_THREAD = 32
"""Arms for which it pays to wake another thread: a step of an arm takes 2 to 3 us, waking a thread about 10."""
NO_STAGE = mujoco.mjtStage.mjSTAGE_NONE.value
"""A reset that computes nothing, since positions are written after it."""
FIRST = 1
"""Number of the first moving body: 0 is the world."""


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
    # as read from the file they are 1, since a reader may refuse what it finds odd
    for link, joint in zip(links, joints, strict=True):
        body = int(model.jnt_bodyid[joint.id])
        model.body_mass[body] = link.mass
        model.body_inertia[body] = link.moments
    return model


class OneArm:
    """An arm alone, with the methods of ``mujoco.batch.Batch`` that it needs, whose steps take longer."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)

    def bind(self, name: str) -> np.ndarray:
        """A field of the data, shape (1, ...)."""
        return np.asarray(getattr(self._data, name))[None]

    def expand(self, name: str) -> np.ndarray:
        """A field of the model, shape (1, ...)."""
        return np.asarray(getattr(self._model, name))[None]

    def reset(self, numbers: list[int], stage: int) -> None:
        """Forget the past."""
        mujoco.mj_resetData(self._model, self._data)

    def step(self, only: np.ndarray | None, count: int) -> None:
        """Make some steps."""
        mujoco.mj_step(self._model, self._data, count)


class MuJoCoBodies(Bodies):
    """Rigid bodies of N arms in MuJoCo; every arm steps as it does alone, bit by bit.

    Masses, inertias, gravity and rotors of each arm can be changed without a model being compiled.

    Args:
        body: the first arm; the others begin as copies of it.
        dt: time step [s].
        count: N.
        threads: on which they are stepped; 0 for one on every processor that this process may use, as long as each has
            ``FEWEST_PER_THREAD`` arms.
    """

    def __init__(
        self, body: RigidBody, dt: float, count: int = 1, threads: int = 0
    ) -> None:
        model = arm_model(moving_links(body), np.asarray(body.gravity), dt)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        usable = os.cpu_count() or 1
        # a container may be bound to fewer processors than the machine has
        if hasattr(os, "sched_getaffinity"):
            usable = len(os.sched_getaffinity(0))
        most = max(1, min(usable, count // FEWEST_PER_THREAD))
        self._batch: OneArm | Batch = (
            OneArm(model)
            if count == 1
            else Batch(model, count, min(count, threads or most))
        )
        self._q, self._dq, self._force, acceleration = (
            self._batch.bind(x) for x in ("qpos", "qvel", "qfrc_applied", "qacc")
        )
        # arms of a batch are far apart in its memory, where numpy takes three times as long
        self._copied = count > 1
        tables = tuple(np.zeros((4, *self._q.shape)))
        # of a single arm these are the engine's own memory, which nothing is copied to
        if not self._copied:
            tables = (*tables[:2], self._dq, self._force)
        self._own_q, self._own_dq, self._own_ahead, self._own_force = tables
        self.position, self.velocity, self.ahead, self.force = (
            table.reshape(-1) for table in tables
        )
        self.acceleration = acceleration.reshape(-1)
        self.rotors = self._batch.expand("dof_armature")
        self._bodies: dict[str, np.ndarray] | None = None
        self.new = True

    def set_bodies(self, number: int, body: RigidBody) -> None:
        """Give an arm, numbered from 0, other bodies of the same structure, and another gravity."""
        # an arm alone is made anew instead
        assert isinstance(self._batch, Batch)
        links = moving_links(body)
        # expanded when they are first changed: most batches only differ in their drives
        if self._bodies is None:
            names = ("mass", "inertia", "ipos", "iquat", "sameframe", "simple")
            self._bodies = {x: self._batch.expand(f"body_{x}") for x in names}
            self._gravity = self._batch.expand("opt.gravity")
        bodies, moving = self._bodies, slice(FIRST, FIRST + len(links))
        bodies["mass"][number, moving] = [link.mass for link in links]
        bodies["inertia"][number, moving] = [link.moments for link in links]
        bodies["ipos"][number, moving] = [x.inertial.translation for x in links]
        turns = np.array([quaternion(link.inertial) for link in links])
        # as MuJoCo's own compiler leaves them
        for turn in turns:
            mujoco.mju_normalize4(turn)
        bodies["iquat"][number, moving] = turns
        # shortcuts for frames that coincide, which the first arm may have had
        bodies["sameframe"][number, moving] = 0
        bodies["simple"][number, moving] = 0
        self._gravity[number] = body.gravity
        # the constants of a single arm are computed before it gets its rotors
        rotors = self.rotors[number].copy()
        self.rotors[number] = 0.0
        self._batch.set_const([number])
        self.rotors[number] = rotors

    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put an arm at positions q [rad or m] with velocities dq, shape (n,), and forget its past."""
        self._batch.reset([number], stage=NO_STAGE)
        self._q[number] = self._own_q[number] = q
        self._dq[number] = self._own_dq[number] = dq
        self.new = True

    def run(self, torque: np.ndarray, count: int) -> None:
        """Hold joint torque [N m or N], shape (N n,), for ``count`` time steps."""
        self._force[...] = torque.reshape(self._force.shape)
        self._batch.step(None, count)
        self._own_q[...], self._own_dq[...] = self._q, self._dq

    def step(self, only: np.ndarray | None = None) -> None:
        """A step under ``force``, of all arms or of those numbered ``only``, which take the last one back."""
        rows: slice | np.ndarray = slice(None)
        if only is not None:
            # slices are faster than lists
            rows = only if len(only) < len(self._q) else rows
            self._q[rows], self._dq[rows] = self._own_q[rows], self._own_dq[rows]
        if self._copied:
            self._force[rows] = self._own_force[rows]
        self._batch.step(only, 1)
        if self._copied:
            self._own_ahead[rows] = self._dq[rows]

    def accept(self, stopped: bool = False) -> None:
        """Take the engine's state."""
        # what sticks has had its velocity set to zero behind the engine's back
        if stopped and self._copied:
            self._dq[...] = self._own_ahead
        self._own_q[...] = self._q
        self.velocity[...] = self.ahead

    def close(self) -> None:
        """Nothing outlives the object."""


ENGINE = MuJoCoBodies
