"""A fleet on disk: two short cases of one type of arm, one with hidden friction."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, Limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

URDF = """<robot name="one"><link name="base"/>
<joint name="pitch" type="revolute"><parent link="base"/><child link="lower"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="99" velocity="9"/></joint>
<link name="lower"><inertial><mass value="4"/><origin xyz="0.3 0.02 0.01"/>
<inertia ixx="0.02" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def _case(folder: Path, viscous: float, seed: int) -> None:
    urdf = folder.parent / "one.urdf"
    urdf.write_text(URDF)
    arm = NominalArm("one", urdf, ("pitch",), armature=np.array([0.2]))
    effects = (AppliedEffect("viscous_friction", (1,), {"coefficient": [viscous]}),)
    body, rng = RigidBody(arm), np.random.default_rng(seed)
    limits = Limits(*(np.full(1, value) for value in (-2.0, 2.0, 2.0, 8.0)))
    recordings = []
    for k, frequency in enumerate((0.2, 0.35)):
        motion = Fourier.random(rng, limits, duration=5.0, frequency=frequency)
        t = np.arange(501) / 100
        seen = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
        tau = CorrectedArm(arm, effects if viscous else ()).predict(body, seen)
        tau = tau + 0.02 * rng.standard_normal((len(t), 1))
        recordings.append(Recording(f"recording_{k}.csv", t, seen.q, tau))
    write_case(Case(folder.name, folder.parent, arm, tuple(recordings)), folder)


@pytest.fixture(scope="session")
def _fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    _case(folder / "arm_A_2026-03-14", 2.0, 1)
    _case(folder / "arm_B_2026-03-14", 0.0, 2)
    (folder / "one.urdf").unlink()
    broken = folder / "arm_C_2026-03-14"
    broken.mkdir()
    text = "name: arm_C_2026-03-14\nrobot: ../../robot.urdf\nrecordings: [a.csv]\n"
    (broken / "case.yaml").write_text(text)
    return folder


@pytest.fixture
def fleet_folder(_fleet: Path, tmp_path: Path) -> Path:
    """Two cases that can be diagnosed, A with friction and B without, and C, which leaves its folder; a copy."""
    return Path(shutil.copytree(_fleet, tmp_path / "fleet"))
