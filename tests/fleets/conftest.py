"""A fleet on disk: two short cases of one type of arm, one with hidden friction."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from arms import HEAVY, chain
from cases import simulated_case

from gapscope.arm.io.write_case import write_case
from gapscope.effects.applied import AppliedEffect


def _case(folder: Path, viscous: float, seed: int) -> None:
    link = HEAVY[1]._replace(origin="0 0 0")
    arm = chain(folder.parent, "one", link, armature=[0.2])
    friction = AppliedEffect("viscous_friction", (1,), {"coefficient": [viscous]})
    how = {"frequencies": (0.2, 0.35), "duration": 5.0, "rate": 100.0, "noise": 0.02}
    where, name = folder.parent, folder.name
    case = simulated_case(
        where, name, arm, (friction,) if viscous else (), seed=seed, **how
    )
    write_case(case, folder)


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
