"""Whether the engines on this machine move an arm as pinocchio does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.simulated_arm import SimulatedArm

STATES = 5
"""Random states that are compared."""
STEP = 1e-4
"""Time step [s]."""
AGREE = 1e-6
"""Difference of the accelerations over the largest that counts as agreement [1]: rounding of a difference of
velocities over one step."""


@dataclass(frozen=True)
class EngineCheck:
    """One engine against pinocchio.

    Attributes:
        engine: its name.
        difference: of the accelerations, over the largest [1]; ``None`` if it could not be run.
        problem: why it could not, or empty.
    """

    engine: str
    difference: float | None
    problem: str = ""

    @property
    def agrees(self) -> bool:
        """Whether it was run and moves the arm as pinocchio does."""
        return self.difference is not None and self.difference < AGREE


def check_engines(robot: str = "kuka_iiwa") -> list[EngineCheck]:
    """Each installed engine with all effects off: acceleration under a torque, at random states.

    Args:
        robot: name or file of the arm.
    """
    return [_check(name, robot) for name in ENGINES if installed(name)]


def _check(engine: str, robot: str) -> EngineCheck:
    try:
        return EngineCheck(engine, _difference(engine, robot))
    except (GapscopeError, ImportError) as error:
        return EngineCheck(engine, None, str(error))


def _difference(engine: str, robot: str) -> float:
    """Largest difference between the engine's accelerations and M^-1 (torque - C dq - g), over the largest."""
    arm = load_nominal_arm(robot)
    silent = np.zeros(arm.n_joints)
    arm = replace(arm, coulomb=silent, viscous=silent)
    body = RigidBody(arm)
    rng = np.random.default_rng(0)
    expected, found = [], []
    with SimulatedArm(arm, (), STEP, engine=engine) as simulated:
        for _ in range(STATES):
            q, dq = rng.uniform(-1, 1, (2, arm.n_joints))
            torque = body.bias(q, dq) + body.mass_matrix(q) @ rng.uniform(-5, 5, len(q))
            simulated.reset(q, dq)
            simulated.step(torque)
            found.append((simulated.dq - dq) / STEP)
            expected.append(
                np.linalg.solve(body.mass_matrix(q), torque - body.bias(q, dq))
            )
    difference = np.abs(np.array(found) - np.array(expected)).max()
    return float(difference / np.abs(expected).max())
