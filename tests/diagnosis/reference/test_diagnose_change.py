"""What changed: pairs of a reference and a case of the three-joint arm, believed with a poor URDF and no friction."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from synthetic import COULOMB, URDF, VISCOUS, Truth, recordings, vendor

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.write_case import write_case
from gapscope.cli import main
from gapscope.diagnosis.diagnose_change import (
    SCALED,
    KeptReference,
    check_same_arm,
    diagnose_change,
    identify_reference,
)
from gapscope.diagnosis.document.diagnosis_json import validate

OFFSET = (0.6, -0.5, 0.2)
"""Torque offsets that the arm has on both days [N m]."""
HEALTHY = Truth(offset=OFFSET)


def case(truth: Truth, seed: int, name: str = "case") -> Case:
    return Case(
        name, vendor().urdf.parent, vendor(), recordings(truth, seed, duration=6.0)
    )


@cache
def reference() -> Case:
    return case(HEALTHY, 1, "reference")


@cache
def identified() -> KeptReference:
    return identify_reference(reference())


def changed(truth: Truth, tmp_path: Path, healthy: Case | None = None):
    known = identify_reference(healthy) if healthy else identified()
    return diagnose_change(case(truth, 2), known, tmp_path)


def warm(share: float) -> dict[str, tuple[float, ...]]:
    return {"coulomb": tuple(share * COULOMB), "viscous": tuple(share * VISCOUS)}


def named(change) -> dict[str, dict]:
    validate(change.diagnosis.document)
    return {effect["effect"]: effect for effect in change.diagnosis.document["effects"]}


def test_another_day_and_motion_is_no_gap(tmp_path):
    change = changed(replace(HEALTHY, **warm(-0.1)), tmp_path)
    assert change.diagnosis.document["verdict"] == "no_gap"
    against = change.diagnosis.document["against"]
    assert against["reference"] == "reference"
    assert against["identified"]["coulomb"] == pytest.approx(COULOMB, rel=0.1)
    assert max(against["held_out"]["torque_nrmse"]) < 0.05


@pytest.mark.nightly
def test_friction_that_rose_on_one_joint(tmp_path):
    found = named(
        changed(replace(HEALTHY, coulomb=(0.0, 0.6 * COULOMB[1], 0.0)), tmp_path)
    )
    assert set(found) == {"coulomb_friction"}
    assert found["coulomb_friction"]["joints"] == [2]
    assert found["coulomb_friction"]["parameters"]["torque"]["value"][
        0
    ] == pytest.approx(0.6 * COULOMB[1], rel=0.15)


@pytest.mark.nightly
def test_torque_constant_that_changed_on_one_joint(tmp_path):
    found = named(changed(replace(HEALTHY, scale=(0.0, 0.12, 0.0)), tmp_path))
    assert set(found) == {"torque_scale"}
    assert found["torque_scale"]["joints"] == [2]
    assert found["torque_scale"]["parameters"]["scale"]["value"][0] == pytest.approx(
        0.12, abs=0.02
    )


@pytest.mark.nightly
def test_offset_that_changed_is_told_as_the_change(tmp_path):
    change = changed(
        replace(HEALTHY, offset=(OFFSET[0], OFFSET[1] + 1.5, OFFSET[2])), tmp_path
    )
    found = named(change)
    assert set(found) == {"torque_offset"}
    assert found["torque_offset"]["joints"] == [2]
    assert found["torque_offset"]["parameters"]["torque"]["value"][0] == pytest.approx(
        1.5, rel=0.1
    )
    then, now = (
        next(e for e in effects if e.name == "torque_offset").per_joint("torque", 3)
        for effects in (change.comparison.effects(), change.effects)
    )
    assert now - then == pytest.approx([0.0, 1.5, 0.0], abs=0.15)


@pytest.mark.nightly
def test_torque_constant_wrong_on_both_days_is_no_load(tmp_path):
    wrong = replace(HEALTHY, scale=(0.15, 0.15, 0.15))
    change = changed(wrong, tmp_path, case(wrong, 1, "reference"))
    assert change.diagnosis.document["verdict"] == "no_gap"


def test_a_reference_of_one_recording_is_doubted():
    several = reference()
    one = replace(several, recordings=several.recordings[:1])
    assert [
        text for text in identify_reference(one).warnings if "one recording" in text
    ]
    kept = identified().warnings
    assert not [text for text in kept if "one recording" in text]


def test_load_with_intervals_and_files_that_predict_what_was_recorded(
    tmp_path, monkeypatch
):
    loaded = replace(HEALTHY, mass=1.2, com=(0.1, 0.02, 0.05))
    write_case(reference(), tmp_path / "reference")
    write_case(case(loaded, 2), tmp_path / "case")
    with pytest.raises(SystemExit) as end:
        main(
            [
                "diagnose",
                str(tmp_path / "case"),
                "--against",
                str(tmp_path / "reference"),
                "--out",
                str(tmp_path / "o"),
            ]
        )
    assert end.value.code == 0
    out = tmp_path / "o"
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["against"]["reference"] == "reference"
    assert SCALED in document["warnings"]
    (found,) = document["effects"]
    assert found["effect"] == "payload"
    mass, com = (found["parameters"][name] for name in ("mass", "com"))
    assert mass["value"] == pytest.approx(1.2, rel=0.05)
    assert abs(mass["value"] - 1.2) < 4 * mass["std"]
    assert com["value"][0] == pytest.approx(0.1, abs=0.02)
    assert (out / "report.html").is_file()
    assert load_case(out / "identified_case.yaml").arm.coulomb == pytest.approx(
        COULOMB, rel=0.1
    )
    file = tmp_path / "case" / "recording_2.csv"
    arguments = [
        "--recording",
        str(file),
        "--model",
        str(out / "corrected.yaml"),
        "--out",
        str(tmp_path / "tau.csv"),
    ]
    with pytest.raises(SystemExit) as end:
        main(["predict", str(out / "identified_case.yaml"), *arguments])
    assert end.value.code == 0
    predicted = np.loadtxt(tmp_path / "tau.csv", delimiter=",", skiprows=1)[:, 1:]
    recorded = case(loaded, 2).recordings[2].tau
    left = (predicted - recorded)[100:-100].std(axis=0) / recorded.std(axis=0)
    assert (left < 0.08).all()

    def never(*arguments):
        raise AssertionError("the reference was identified again")

    monkeypatch.setattr("gapscope.interface.diagnose.identify_reference", never)
    again = gapscope.diagnose(tmp_path / "case", against=out / "identified")
    again.save(tmp_path / "again")
    assert json.loads((tmp_path / "again" / "diagnosis.json").read_text()) == document
    for name in ("identified.urdf", "corrected.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes()
    assert not (tmp_path / "again" / "identified").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"joints": ("joint_2", "joint_1", "joint_3")}, "another order"),
        ({"joints": ("a", "b", "c")}, "other names"),
        ({"gravity": np.array([0.0, 0.0, 9.81])}, "gravity"),
    ],
)
def test_another_robot_is_refused(change, says):
    other = replace(reference(), arm=replace(vendor(), **change))
    with pytest.raises(InputError, match=says):
        check_same_arm(case(HEALTHY, 2), other)


def test_fewer_joints_and_other_places_are_refused(tmp_path):
    two = replace(
        vendor(),
        joints=vendor().joints[:2],
        armature=None,
        coulomb=None,
        viscous=None,
        presliding=None,
    )
    with pytest.raises(InputError, match="has 2 joints"):
        check_same_arm(case(HEALTHY, 2), replace(reference(), arm=two))
    longer = tmp_path / "longer.urdf"
    longer.write_text(URDF.replace('xyz="0.45 0 0"', 'xyz="0.5 0 0"'))
    with pytest.raises(InputError, match="other places"):
        check_same_arm(
            case(HEALTHY, 2), replace(reference(), arm=replace(vendor(), urdf=longer))
        )


def test_reference_without_torque_or_too_short_is_refused():
    silent = replace(
        reference(),
        recordings=tuple(replace(r, tau=None) for r in reference().recordings),
    )
    with pytest.raises(GapscopeError, match="no recording carries a torque"):
        identify_reference(silent)
    only = reference().recordings[0]
    rows = slice(0, 200)
    short = replace(only, t=only.t[rows], q=only.q[rows], tau=only.tau[rows])
    with pytest.raises(InputError, match="last|hold"):
        identify_reference(replace(reference(), recordings=(short,)))
