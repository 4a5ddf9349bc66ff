"""What is installed: versions of packages, and whether the engines agree with the equations."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from importlib import metadata

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.simulated_arm import SimulatedArm

# Which packages are installed, and which commands need those that are not.


NEEDED_FOR = {
    "blind": "gapscope blind make",
    "cluster": "gapscope fleet and diagnose --backend ray",
    "hdf5": "logs in HDF5 and MATLAB 7.3 files",
    "learn": "gapscope train, gapscope residual, agents in gapscope evaluate",
    "pybullet": "--engine pybullet, the robot xarm6",
    "robots": "robots by the names of robot_descriptions",
    "tune": "gapscope train --tune",
}
"""What each extra is for; ``dev`` is for developers and left out."""
_NAME = re.compile(r"^[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")


@dataclass(frozen=True)
class Package:
    """A package that the project names.

    Attributes:
        name: of its distribution.
        version: that is installed, or ``None``.
        extra: that brings it; empty if the core needs it.
        needed_for: what does not work without it.
    """

    name: str
    version: str | None
    extra: str
    needed_for: str

    @property
    def remedy(self) -> str:
        """How to install it."""
        what = f"gapscope[{self.extra}]" if self.extra else self.name
        return f"pip install '{what}'"


def packages() -> list[Package]:
    """Packages of the core, then of the extras, as the installed project names them."""
    core, extras = [], []
    for requirement in metadata.requires("gapscope") or ():
        name, extra = _name(requirement), _EXTRA.search(requirement)
        # a marker limits a requirement to some machines; PyBullet is asked for as an extra
        if ";" not in requirement:
            core.append(Package(name, installed_version(name), "", "every command"))
        elif extra and extra[1] in NEEDED_FOR:
            needed_for = NEEDED_FOR[extra[1]]
            version = installed_version(name)
            extras.append(Package(name, version, extra[1], needed_for))
    return [*core, *extras]


def _name(requirement: str) -> str:
    match = _NAME.match(requirement)
    assert match is not None, requirement
    return match[0]


def installed_version(name: str) -> str | None:
    """Version of a package that is installed, or ``None``."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


# Whether the engines on this machine move an arm as pinocchio does.


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


def check_engines() -> list[EngineCheck]:
    """Each installed engine with all effects off: acceleration under a torque, at random states."""
    return [_check(name) for name in ENGINES if installed(name)]


def _check(engine: str) -> EngineCheck:
    try:
        # largest difference between the engine's accelerations and M^-1 (torque - C dq - g), over the largest
        arm = load_nominal_arm("kuka_iiwa")
        # the equation below has no friction
        silent = np.zeros(arm.n_joints)
        arm = replace(arm, coulomb=silent, viscous=silent)
        body = RigidBody(arm)
        rng = np.random.default_rng(0)
        expected, found = [], []
        with SimulatedArm(arm, (), STEP, engine=engine) as simulated:
            for _ in range(STATES):
                q, dq = rng.uniform(-1, 1, (2, arm.n_joints))
                # torque by acceleration: the same on light and heavy joints
                torque = body.bias(q, dq) + body.mass_matrix(q) @ rng.uniform(
                    -5, 5, len(q)
                )
                simulated.reset(q, dq)
                simulated.step(torque)
                # by one step that is short beside any motion
                found.append((simulated.dq - dq) / STEP)
                expected.append(
                    np.linalg.solve(body.mass_matrix(q), torque - body.bias(q, dq))
                )
        difference = np.abs(np.array(found) - np.array(expected)).max()
        return EngineCheck(engine, float(difference / np.abs(expected).max()))
    except (GapscopeError, ImportError) as error:
        return EngineCheck(engine, None, str(error))
