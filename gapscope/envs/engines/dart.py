"""The DART engine through ``dartpy``, of the extra ``dart``; it is the engine that Gazebo uses by default."""

from __future__ import annotations

import dartpy
import numpy as np

from gapscope.arm.dynamics.plain_urdf import Link, link_name, plain_urdf, rotation
from gapscope.envs.engines import Engine


class DartEngine(Engine):
    """Rigid bodies in a DART world of their own.

    Args:
        links: the moving bodies, parents before children.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].
    """

    def __init__(self, links: tuple[Link, ...], gravity: np.ndarray, dt: float) -> None:
        fixed = dartpy.utils.DartLoaderRootJointType.FIXED
        loader = dartpy.utils.DartLoader()
        loader.setOptions(dartpy.utils.DartLoaderOptions(defaultRootJointType=fixed))
        self._arm = loader.parseSkeletonString(plain_urdf(links), dartpy.common.Uri())
        for link in links:
            body = self._arm.getBodyNode(link_name(link.joint))
            axes = rotation(link.inertial)
            moment = axes @ np.diag(link.moments) @ axes.T
            body.setInertia(
                dartpy.dynamics.Inertia(link.mass, link.inertial[0], moment)
            )
            self._arm.getJoint(link.joint).setLimitEnforcement(link.limits is not None)
        self._world = dartpy.simulation.World()
        self._world.setGravity(np.asarray(gravity, dtype=float))
        self._world.setTimeStep(dt)
        self._world.addSkeleton(self._arm)
        awake = self._world.getDeactivationOptions()
        awake.mEnabled = False
        self._world.setDeactivationOptions(awake)
        places = np.array(
            [self._arm.getDof(link.joint).getIndexInSkeleton() for link in links]
        )
        self._order, self._places = np.argsort(places), places
        self.q, self.dq = np.zeros((2, len(links)))

    def reset(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q [rad or m] with velocities dq."""
        self._arm.setPositions(q[self._order])
        self._arm.setVelocities(dq[self._order])
        self._arm.resetAccelerations()
        self._arm.resetCommands()
        self.read()

    def step(self, torque: np.ndarray, count: int = 1) -> None:
        """Hold joint torque [N m or N] for ``count`` time steps; DART forgets it after each."""
        forces = torque[self._order]
        for _ in range(count):
            self._arm.setForces(forces)
            self._world.step()

    def read(self) -> None:
        """Bring ``q`` and ``dq`` up to date."""
        self.q[:] = self._arm.getPositions()[self._places]
        self.dq[:] = self._arm.getVelocities()[self._places]

    def close(self) -> None:
        """Nothing outlives the object."""
