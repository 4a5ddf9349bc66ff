"""The engines that move rigid bodies; only here is a physics engine imported."""

from __future__ import annotations

import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.plain_urdf import Link
from gapscope.arm.errors import EngineWarning, InputError
from gapscope.arm.nearest_name import check_known
from gapscope.envs.engines.engine import Engine


class _Kind(NamedTuple):
    """Where an engine is: its class, the library that it needs, and how to install that."""

    module: str
    name: str
    library: str
    install: str


ENGINES = {
    "pybullet": _Kind(
        "gapscope.envs.engines.pybullet",
        "PyBulletEngine",
        "pybullet",
        "pip install 'gapscope[pybullet]', which has wheels for Python 3.10 and 3.11 on Linux",
    ),
    "mujoco": _Kind(
        "gapscope.envs.engines.mujoco",
        "MuJoCoEngine",
        "mujoco",
        "pip install mujoco",
    ),
    "dart": _Kind(
        "gapscope.envs.engines.dart",
        "DartEngine",
        "dartpy",
        "pip install 'gapscope[dart]'",
    ),
}
"""The engines by name."""


def installed(name: str) -> bool:
    """Whether the library of an engine is installed."""
    return find_spec(ENGINES[name].library) is not None


@cache
def default_engine() -> str:
    """The engine that is used if none is named: PyBullet if it is installed, else MuJoCo, which a warning says."""
    if installed("pybullet"):
        return "pybullet"
    message = "PyBullet is not installed, MuJoCo simulates the arm"
    warnings.warn(
        f"{message} ({ENGINES['pybullet'].install})", EngineWarning, stacklevel=2
    )
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
            f"the engine {name} is not installed", ENGINES[name].install, where="engine"
        )
    return name


def make_engine(
    name: str | None, links: tuple[Link, ...], gravity: np.ndarray, dt: float
) -> Engine:
    """The engine called ``name`` with an arm in it.

    Args:
        name: one of ``ENGINES``; ``None`` for the default engine.
        links: the moving bodies, parents before children.
        gravity: in the base frame [m/s^2], shape (3,).
        dt: time step [s].

    Raises:
        InputError: no such engine, or it is not installed.
    """
    kind = ENGINES[check_engine(name)]
    engine: Engine = getattr(import_module(kind.module), kind.name)(links, gravity, dt)
    return engine
