"""The PyBullet engine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gapscope.arm.dynamics.plain_urdf import Link, plain_urdf
from gapscope.envs.engines import Engine


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


class PyBulletEngine(Engine):
    """Rigid bodies in a PyBullet world of their own. PyBullet lets no joint turn faster than 100 rad/s.

    Args:
        links: the moving bodies, parents before children.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].
    """

    def __init__(self, links: tuple[Link, ...], gravity: np.ndarray, dt: float) -> None:
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._robot, self._joints = _load(self._client, links, gravity, dt)
        self.q, self.dq = np.zeros((2, len(links)))
        client = {"physicsClientId": self._client}
        self._set = partial(
            pybullet.setJointMotorControlArray,
            self._robot,
            self._joints,
            pybullet.TORQUE_CONTROL,
            **client,
        )
        self._advance = partial(pybullet.stepSimulation, **client)
        self._states = partial(
            pybullet.getJointStates, self._robot, self._joints, **client
        )

    def reset(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q [rad or m] with velocities dq."""
        for joint, position, velocity in zip(
            self._joints, q.tolist(), dq.tolist(), strict=True
        ):
            pybullet.resetJointState(
                self._robot, joint, position, velocity, physicsClientId=self._client
            )
        self.read()

    def step(self, torque: np.ndarray, count: int = 1) -> None:
        """Hold joint torque [N m or N] for ``count`` time steps; PyBullet forgets it after each."""
        forces, hold, advance = torque.tolist(), self._set, self._advance
        hold(forces=forces)
        advance()
        for _ in range(count - 1):
            hold(forces=forces)
            advance()

    def read(self) -> None:
        """Bring ``q`` and ``dq`` up to date."""
        states = self._states()
        self.q[:] = [state[0] for state in states]
        self.dq[:] = [state[1] for state in states]

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
    index = {info[1].decode(): i for i, info in enumerate(infos)}
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
    zeros = [0.0] * len(joints)
    pybullet.setJointMotorControlArray(
        robot, joints, pybullet.VELOCITY_CONTROL, forces=zeros, physicsClientId=client
    )
    return robot, joints
