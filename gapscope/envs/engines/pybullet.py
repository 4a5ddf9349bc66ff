"""The PyBullet engine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy import add, multiply, subtract

from gapscope.arm.dynamics.plain_urdf import Link, moving_links, plain_urdf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ForwardDynamics
from gapscope.envs.engines import Bodies


@contextmanager
def quiet_errors() -> Iterator[None]:
    """Nothing that is written to the file descriptor of standard error meanwhile appears; exceptions pass."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        os.close(nowhere)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


with quiet_errors():  # it says there when it was built
    import pybullet


READ_EVERY = 20
"""Steps after which the engine is asked for its state: rounding would grow, since the torque given is no feedback."""
NEAR_LIMIT = 0.1
"""Distance from a joint's limit [rad] within which the engine is asked for its state after every step."""


class PyBulletBodies(Bodies):
    """One arm in a PyBullet world of its own, where no joint turns faster than 100 rad/s.

    PyBullet has no rotors: a step is solved first, and M a + h, the torque that makes it, is given on. Away from limits
    the next state is the one solved for, to rounding, and is read now and then only.

    Args:
        body: the loaded arm.
        dt: time step [s].
    """

    def __init__(self, body: RigidBody, dt: float) -> None:
        links, n = moving_links(body), body.n_joints
        self._client = pybullet.connect(pybullet.DIRECT)
        client = {"physicsClientId": self._client}
        self._robot, self._joints = _load(self._client, links, body.gravity, dt)
        arm = self._robot, self._joints
        self._hold = partial(
            pybullet.setJointMotorControlArray,
            *arm,
            pybullet.TORQUE_CONTROL,
            **client,
        )
        self._advance = partial(pybullet.stepSimulation, **client)
        self._states = partial(pybullet.getJointStates, *arm, **client)
        limits = np.array([link.limits or (-np.inf, np.inf) for link in links]).T
        # read from the engine in time, before a joint comes to its limit
        self._lowest, self._highest = limits[0] + NEAR_LIMIT, limits[1] - NEAR_LIMIT
        self.position, self.velocity, self.force, self.ahead, self._work = np.zeros(
            (5, n)
        )
        self.rotors, self._steps = np.zeros((1, n)), np.full(n, dt)
        self._rotors = self.rotors[0]
        self._forward = ForwardDynamics(body, self._rotors)

    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q [rad or m] with velocities dq, shape (n,)."""
        for state in zip(self._joints, q.tolist(), dq.tolist(), strict=True):
            pybullet.resetJointState(self._robot, *state, physicsClientId=self._client)
        self._read()

    def set_rotors(self, rotors: np.ndarray) -> None:
        """Change the inertia on the diagonal of the mass matrix [kg m^2], shape (n,)."""
        super().set_rotors(rotors)
        self._forward.set_rotors(self._rotors)

    def run(self, torque: np.ndarray, count: int) -> None:
        """Hold joint torque [N m or N], shape (n,), for ``count`` time steps; PyBullet forgets it after each."""
        forces = torque.tolist()
        for _ in range(count):
            self._hold(forces=forces)
            self._advance()
        self._read()

    def step(self, only: np.ndarray | None = None) -> None:
        """Solve a step under ``force``: its acceleration and the velocity after it."""
        acceleration = self._forward.acceleration(
            self.position, self.velocity, self.force
        )
        multiply(acceleration, self._steps, self._work)
        add(self._work, self.velocity, self.ahead)
        self.acceleration = acceleration

    def accept(self, stopped: bool = False) -> None:
        """Give on what makes the step that was solved last."""
        work = self._work
        # what rotors, friction and what holds have taken
        multiply(self._rotors, self.acceleration, work)
        subtract(self.force, work, work)
        self._hold(forces=work.tolist())
        self._advance()
        self._unread += 1
        if self._near or self._unread == READ_EVERY:
            self._read()
            return
        # off the limits the engine makes the very step that was solved
        self.velocity[...] = self.ahead
        multiply(self.ahead, self._steps, work)
        add(self.position, work, self.position)

    def _read(self) -> None:
        """Take the engine's state, which includes joint limits."""
        q, states = self.position, self._states()
        q[:] = [state[0] for state in states]
        self.velocity[:] = [state[1] for state in states]
        self._unread, self.new = 0, True
        self._near = bool(np.count_nonzero((q < self._lowest) | (q > self._highest)))

    def close(self) -> None:
        """Free the PyBullet world."""
        if self._client is not None:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = None


def _load(
    client: int, links: tuple[Link, ...], gravity: np.ndarray, dt: float
) -> tuple[int, list[int]]:
    """Load the bodies into a PyBullet world; its id of the arm, and of the joints in the links' order."""
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(plain_urdf(links))
        # a cached file would be that of an arm before
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        robot = pybullet.loadURDF(
            str(file), useFixedBase=True, flags=flags, physicsClientId=client
        )
    pybullet.setGravity(*np.asarray(gravity).tolist(), physicsClientId=client)
    pybullet.setTimeStep(dt, physicsClientId=client)
    infos = [
        pybullet.getJointInfo(robot, i, physicsClientId=client)
        for i in range(len(links))
    ]
    # PyBullet numbers joints in its own order, here by name
    index = {info[1].decode(): i for i, info in enumerate(infos)}
    # damping that PyBullet has by default, of the base and of every link
    pybullet.changeDynamics(
        robot, -1, linearDamping=0, angularDamping=0, physicsClientId=client
    )
    for link in links:
        pybullet.changeDynamics(
            robot,
            index[link.joint],
            linearDamping=0,
            angularDamping=0,
            jointDamping=0,
            localInertiaDiagonal=link.moments.tolist(),
            physicsClientId=client,
        )
    joints = [index[link.joint] for link in links]
    # every joint begins with a motor that holds it; without force it is off
    zeros = [0.0] * len(joints)
    pybullet.setJointMotorControlArray(
        robot, joints, pybullet.VELOCITY_CONTROL, forces=zeros, physicsClientId=client
    )
    return robot, joints


ENGINE = PyBulletBodies
