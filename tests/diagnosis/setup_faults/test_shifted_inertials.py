"""Files with inertials moved: none for a trial, one for each text that is kept."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import arm

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.shifted_inertials import shifted_arm, shifted_body


def copied(folder: Path, change: tuple[str, str] = ("", "")) -> NominalArm:
    """The arm, with its URDF at another place."""
    folder.mkdir(exist_ok=True)
    file = folder / "robot.urdf"
    file.write_text(arm().urdf.read_text(encoding="utf-8").replace(*change))
    return replace(arm(), urdf=file)


def torque(body: RigidBody) -> np.ndarray:
    """Of one moment of a motion [N m]."""
    return body.torque(*np.full((3, body.n_joints), 0.3))


def test_a_trial_has_the_same_dynamics_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = shifted_arm(arm(), 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    body = shifted_body(arm(), 1)
    assert body is not None and shifted_body(arm(), 0) is None
    np.testing.assert_array_equal(torque(body), torque(RigidBody(kept)))
    assert not np.allclose(torque(body), torque(RigidBody(arm())))
    assert not list(tmp_path.iterdir())


def test_cases_of_one_arm_share_a_file_and_a_changed_arm_has_its_own(
    tmp_path: Path,
) -> None:
    first, second = copied(tmp_path / "a"), copied(tmp_path / "b")
    assert shifted_arm(first, 1).urdf == shifted_arm(second, 1).urdf
    changed = copied(tmp_path / "a", ('mass value="6"', 'mass value="7"'))
    other = shifted_arm(changed, 1)
    assert other.urdf != shifted_arm(second, 1).urdf
    assert 'mass value="7"' in other.urdf.read_text(encoding="utf-8")
