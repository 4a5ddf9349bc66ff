"""Arms that several tests simulate."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import ROD, written
from own_effects import RECORDS

from gapscope.arm.nominal import NominalArm
from gapscope.effects.catalogue import register, remove
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.mystery_arm import iiwa


@pytest.fixture(scope="session")
def data_sheet_arm() -> NominalArm:
    """A KUKA iiwa with armature and friction."""
    return iiwa()


@pytest.fixture(scope="session")
def bare_arm(data_sheet_arm: NominalArm) -> NominalArm:
    """The same without armature, friction and torque limits."""
    return NominalArm("bare", data_sheet_arm.urdf, data_sheet_arm.joints)


@pytest.fixture(scope="session")
def coupled_arm(bare_arm: NominalArm) -> NominalArm:
    """The same with a motor 7 that turns joint 6, too: its speed is dq7 - dq6."""
    coupling = np.eye(7)
    coupling[6, 5] = -1.0
    return replace(bare_arm, coupling=coupling)


@pytest.fixture(scope="session")
def pendulum_urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pendulum's URDF file."""
    return written(
        tmp_path_factory.mktemp("pendulum") / "pendulum.urdf", "pendulum", ROD
    )


@pytest.fixture
def pendulum(pendulum_urdf: Path):
    """Makes a pendulum with the given data sheet."""

    def make(**sheet: float) -> NominalArm:
        values = {name: np.array([value]) for name, value in sheet.items()}
        return NominalArm("pendulum", pendulum_urdf, ("hinge",), **values)

    return make


@pytest.fixture(scope="session")
def engines():
    """Gives the name of an engine back where it is installed, and skips otherwise."""

    def check(name: str) -> str:
        if not installed(name):
            pytest.skip(f"the engine {name} is not installed: {ENGINES[name].install}")
        return name

    return check


@pytest.fixture
def own() -> Iterator[None]:
    """The catalogue with effects of a user."""
    for record in RECORDS.values():
        register(record)
    yield
    for name in RECORDS:
        remove(name)
