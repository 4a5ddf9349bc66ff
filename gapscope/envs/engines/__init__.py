"""The engines that move rigid bodies under joint torque; only here is a physics engine imported.

Everything else about an arm is the drive's.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from functools import cache
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import EngineWarning, InputError
from gapscope.arm.nearest_name import check_known


class Bodies(ABC):
    """Rigid bodies of N arms with rotors, n joints each in kinematic order, whose steps are tried before they are made.

    Bases are fixed, and joints have no friction. A step is semi-implicit: dq[k+1] = dq[k] + dt ddq(q[k], dq[k],
    torque[k]), q[k+1] = q[k] + dt dq[k+1]. The central difference of q at step k is therefore the acceleration that the
    torque of step k causes: position and torque of one step belong together, without the half step by which a held
    torque acts late.

    Arrays hold the joints of all arms in a row, those of the first arm first, (N n,), and keep their places.

    Attributes:
        position, velocity: present state [rad], [rad/s]; read only.
        force: joint torque of the next step [N m or N]; to be written.
        ahead: velocity after the step that was tried last [rad/s]; it may be written before the step is made.
        acceleration: of that step [rad/s^2]; read only, another array after each.
        rotors: inertia on the diagonal of the mass matrix [kg m^2], shape (N, n); read only.
        new: whether an arm has come to its state otherwise than by the last step.
    """

    new: bool
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    ahead: np.ndarray
    acceleration: np.ndarray
    rotors: np.ndarray

    @abstractmethod
    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put an arm, numbered from 0, at positions q [rad or m] with velocities dq, shape (n,)."""

    def set_bodies(self, number: int, body: RigidBody) -> None:
        """Give an arm other bodies of the same structure, and another gravity, in an engine that holds several."""
        raise NotImplementedError

    def set_rotors(self, rotors: np.ndarray) -> None:
        """Change the inertia on the diagonal of the mass matrix [kg m^2], shape (N n,)."""
        self.rotors[...] = rotors.reshape(self.rotors.shape)

    @abstractmethod
    def run(self, torque: np.ndarray, count: int) -> None:
        """Hold joint torque [N m or N], shape (N n,), for ``count`` time steps."""

    @abstractmethod
    def step(self, only: np.ndarray | None = None) -> None:
        """Try a step under ``force``: ``ahead`` and ``acceleration`` are those of it.

        ``only``: numbers of the arms that try again, sorted, shape (k,); all by default.
        """

    @abstractmethod
    def accept(self, stopped: bool = False) -> None:
        """Make the steps that were tried last; ``stopped`` says that ``ahead`` was written."""

    @abstractmethod
    def close(self) -> None:
        """Free the world; a second call does nothing."""


ENGINES = {
    "pybullet": "pip install 'gapscope[pybullet]', which has wheels for Python 3.10 and 3.11 on Linux",
    "mujoco": "pip install mujoco",
}
"""How to install each engine, by its name, which is that of its library and of a module beside this one."""


def installed(name: str) -> bool:
    """Whether the library of an engine is installed."""
    return find_spec(name) is not None


@cache
def default_engine() -> str:
    """The engine that is used if none is named: PyBullet if it is installed, else MuJoCo, which a warning says."""
    if installed("pybullet"):
        return "pybullet"
    message = "PyBullet is not installed, MuJoCo simulates the arm"
    warnings.warn(f"{message} ({ENGINES['pybullet']})", EngineWarning, stacklevel=2)
    return "mujoco"


def check_engine(name: str | None) -> str:
    """The name, if there is such an engine and it is installed; the default engine for ``None``.

    Raises:
        InputError: no such engine, the nearest name is offered; or it is not installed.
    """
    if name is None:
        return default_engine()
    check_known("engine", name, ENGINES, where="engine")
    if not installed(name):
        raise InputError(
            f"the engine {name} is not installed", ENGINES[name], where="engine"
        )
    return name


def make_bodies(name: str | None, body: RigidBody, dt: float, **options: int) -> Bodies:
    """The bodies of an arm, or of several, in the engine called ``name``.

    Args:
        name: one of ``ENGINES``; ``None`` for the default engine.
        body: the arm.
        dt: time step [s].
        options: ``count`` and ``threads`` of ``gapscope.envs.engines.mujoco.MuJoCoBodies``.

    Raises:
        InputError: no such engine, or it is not installed.
    """
    # imported only when it is asked for: an engine that is not installed harms nobody
    engine = import_module(f"{__name__}.{check_engine(name)}")
    bodies = engine.ENGINE(body, dt, **options)
    return bodies
