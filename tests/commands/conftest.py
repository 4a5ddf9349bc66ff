"""A case on disk, and the command line called as a user would."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, Limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.cli import main
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

LINK = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="99" velocity="9"/></joint>
  <link name="{child}"><inertial><mass value="4"/><origin xyz="0.3 0.02 0.01"/>
    <inertia ixx="0.02" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
URDF = (
    '<robot name="two"><link name="base"/>'
    + LINK.format(
        name="yaw", parent="base", child="upper", origin="0 0 0", axis="0 0 1"
    )
    + LINK.format(
        name="pitch", parent="upper", child="lower", origin="0.6 0 0.1", axis="0 1 0"
    )
    + "</robot>"
)
HIDDEN = AppliedEffect("viscous_friction", (2,), {"coefficient": [3.0]})
"""What the arm of ``sick`` has and its data sheet lacks."""


class Outcome(NamedTuple):
    """What a command left: exit code, standard output, standard error."""

    code: int
    out: str
    err: str


@pytest.fixture
def gapscope(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Runs a command in this process."""

    def call(*arguments: object) -> Outcome:
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        code = ended.value.code
        assert code is None or isinstance(code, int)
        return Outcome(code or 0, *capsys.readouterr())

    return call


def _make(folder: Path, name: str, effects: tuple[AppliedEffect, ...]) -> Path:
    urdf = folder / f"{name}.urdf"
    urdf.write_text(URDF)
    sheet = {"armature": [0.5, 0.2], "coulomb": [1.5, 1.0], "viscous": [1.0, 1.0]}
    arm = NominalArm(
        "two",
        urdf,
        ("yaw", "pitch"),
        **{key: np.array(value) for key, value in sheet.items()},
    )
    body, rng = RigidBody(arm), np.random.default_rng(3)
    limits = Limits(np.full(2, -2.0), np.full(2, 2.0), np.full(2, 2.0), np.full(2, 8.0))
    recordings = []
    for k, frequency in enumerate((0.15, 0.25, 0.35)):
        motion = Fourier.random(rng, limits, duration=6.0, frequency=frequency)
        t = np.arange(1501) / 250
        seen = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
        tau = CorrectedArm(arm, effects).predict(
            body, seen
        ) + 0.05 * rng.standard_normal((len(t), 2))
        recordings.append(Recording(f"recording_{k}.csv", t, seen.q, tau))
    write_case(Case(name, folder, arm, tuple(recordings)), folder / name)
    return folder / name


@pytest.fixture(scope="session")
def _cases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cases")
    _make(folder, "sick", (HIDDEN,))
    _make(folder, "healthy", ())
    return folder


@pytest.fixture
def sick(_cases: Path, tmp_path: Path) -> Path:
    """A case with hidden viscous friction on joint 2; a copy that may be damaged."""
    return Path(shutil.copytree(_cases / "sick", tmp_path / "sick"))


@pytest.fixture
def healthy(_cases: Path, tmp_path: Path) -> Path:
    """A healthy case; a copy that may be damaged."""
    return Path(shutil.copytree(_cases / "healthy", tmp_path / "healthy"))


@pytest.fixture
def corrected(tmp_path: Path) -> Path:
    """A corrected.yaml that tells the truth about ``sick``."""
    path = tmp_path / "corrected.yaml"
    path.write_text(
        "schema: 1\neffects:\n  - {effect: viscous_friction, joints: [2], parameters: {coefficient: [3.0]}}\n"
    )
    return path
