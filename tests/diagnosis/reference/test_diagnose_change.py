"""What changed: pairs of a reference and a case of the three-joint arm, believed with a poor URDF and no friction."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import case_of, each
from synthetic import COULOMB, VISCOUS, Truth, recordings, vendor

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.io.write_case import write_case
from gapscope.diagnosis.diagnose_change import (
    SCALED,
    KeptReference,
    diagnose_change,
    identify_reference,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_corrected_arm

OFFSET = (0.6, -0.5, 0.2)
"""Torque offsets that the arm has on both days [N m]."""
HEALTHY = Truth(offset=OFFSET)


def case(truth: Truth, seed: int, name: str = "case") -> Case:
    return case_of(name, vendor(), *recordings(truth, seed, duration=6.0))


@cache
def reference() -> Case:
    return case(HEALTHY, 1, "reference")


@cache
def identified() -> KeptReference:
    return identify_reference(reference())


def changed(truth: Truth, tmp_path: Path, healthy: Case | None = None):
    known = identify_reference(healthy) if healthy else identified()
    return diagnose_change(case(truth, 2), known, tmp_path)


def test_another_day_and_motion_is_no_gap(tmp_path):
    cool = {"coulomb": tuple(-0.1 * COULOMB), "viscous": tuple(-0.1 * VISCOUS)}
    change = changed(replace(HEALTHY, **cool), tmp_path)
    assert change.diagnosis.document["verdict"] == "no_gap"
    against = change.diagnosis.document["against"]
    assert against["reference"] == "reference"
    assert against["identified"]["coulomb"] == pytest.approx(COULOMB, rel=0.1)
    assert max(against["held_out"]["torque_nrmse"]) < 0.05


@pytest.mark.nightly
def test_offset_that_changed_is_told_as_the_change(tmp_path):
    """And the corrected arm has what it was then as well."""
    more = (OFFSET[0], OFFSET[1] + 1.5, OFFSET[2])
    change = changed(replace(HEALTHY, offset=more), tmp_path)
    (found,) = change.diagnosis.document["effects"]
    assert (found["effect"], found["joints"]) == ("torque_offset", [2])
    assert found["parameters"]["torque"]["value"] == pytest.approx([1.5], rel=0.1)
    inherent = change.diagnosis.document["against"]["inherent"]
    known = (AppliedEffect(x["effect"], x["joints"], x["parameters"]) for x in inherent)
    then, now = (
        next(e for e in effects if e.name == "torque_offset").per_joint("torque", 3)
        for effects in (known, change.effects)
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
    tmp_path, monkeypatch, command
):
    loaded = replace(HEALTHY, mass=1.2, com=(0.1, 0.02, 0.05))
    before, today, out = (tmp_path / name for name in ("reference", "case", "o"))
    write_case(reference(), before)
    write_case(case(loaded, 2), today)
    assert command("diagnose", today, "--against", before, "--out", out).code == 0
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
    kept = load_case(out / "identified_case.yaml")
    assert kept.arm.coulomb == pytest.approx(COULOMB, rel=0.1)
    torque = tmp_path / "tau.csv"
    arguments = ["--recording", today / "recording_2.csv", "--out", torque]
    arguments += ["--model", out / "corrected.yaml"]
    assert command("predict", out / "identified_case.yaml", *arguments).code == 0
    predicted = np.loadtxt(torque, delimiter=",", skiprows=1)[:, 1:]
    recorded = case(loaded, 2).recordings[2].tau
    left = (predicted - recorded)[100:-100].std(axis=0) / recorded.std(axis=0)
    assert (left < 0.08).all()

    def never(*arguments):
        raise AssertionError("the reference was identified again")

    monkeypatch.setattr("gapscope.interface.diagnose.identify_reference", never)
    again = tmp_path / "again"
    gapscope.diagnose(today, against=out / "identified").save(again)
    assert json.loads((again / "diagnosis.json").read_text()) == document
    for name in ("identified.urdf", "corrected.yaml"):
        assert (again / name).read_bytes() == (out / name).read_bytes()
    assert not (again / "identified").exists()


def test_what_one_effect_cannot_take_another_of_the_arm_makes_up_for(tmp_path):
    """A spring and an offset share a constant torque that a rest within its bounds cannot make; friction of a searched
    form, which both days have, counts once."""
    both = {"offset": (0.6, -30.0, 0.2), "saturation": (4.0, 0.0, 0.0)}
    truth = replace(HEALTHY, **both)
    before, today, out = (tmp_path / name for name in ("reference", "case", "o"))
    write_case(case(truth, 1, "reference"), before)
    write_case(case(replace(truth, mass=1.2), 2), today)
    gapscope.diagnose(today, against=before).save(out)
    recorded = case(replace(truth, mass=1.2), 2).recordings[2]
    file = out / "corrected.yaml"
    found = gapscope.predict(out / "identified_case.yaml", "recording_2.csv", file)
    left = (found.tau - recorded.tau)[100:-100]
    assert np.sqrt((left**2).mean(axis=0)) == pytest.approx(0.0, abs=0.5)
    # without the arm that was identified the file means another one
    with pytest.warns(ModelWarning, match="identified_case.yaml"):
        read_corrected_arm(vendor(), file)


def test_reference_without_torque_or_too_short_is_refused():
    silent = each(reference(), lambda r: replace(r, tau=None))
    with pytest.raises(GapscopeError, match="no recording carries a torque"):
        identify_reference(silent)
    short = each(reference(), lambda r: r.part(slice(0, 200)))
    with pytest.raises(InputError, match="last|hold"):
        identify_reference(replace(short, recordings=short.recordings[:1]))
