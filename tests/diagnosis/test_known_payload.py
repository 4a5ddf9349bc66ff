"""A known payload: recordings with and without it are used together, and what is found is beyond it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic
from cases import case_of
from sensed import reading
from sweeps import daily
from synthetic import Joints, Truth, named

from gapscope.arm.case import Case
from gapscope.arm.known_load import KnownLoad
from gapscope.diagnosis.assessment.sensor_sides import link_torque
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.diagnose_change import (
    Change,
    diagnose_change,
    identify_reference,
)
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.model.conditioning import Segment, condition

LOAD = KnownLoad(2.0, (0.1, -0.03, 0.05))
CUTOFF = 10.0
HEALTHY = Truth()


def loaded(truth: Truth) -> Truth:
    """The truth with the known load beside what is on the last link already, as one body of the same first moment.

    A point mass more or less than the two differ by a moment of inertia that no test here can see.
    """
    mass = truth.mass + LOAD.mass
    moment = truth.mass * np.array(truth.com) + LOAD.mass * np.array(LOAD.com)
    return replace(truth, mass=mass, com=tuple(moment / mass))


def case(
    truth: Truth = HEALTHY, *, declared: bool = True, sensors: bool = False
) -> Case:
    """Three recordings, the second with a load, which the case declares or not; with torque sensors or without."""
    there = [truth, loaded(truth), truth]
    made = [synthetic.recordings(each, 2)[k] for k, each in enumerate(there)]
    if declared:
        made[1] = replace(made[1], payload=LOAD)
    if sensors:
        rng = np.random.default_rng(1002)
        for k, (each, frequency) in enumerate(zip(there, (0.1, 0.2, 0.3), strict=True)):
            exact = reading(each, synthetic.motion(20 + k, frequency, 8.0), made[k].t)
            noise = 0.1 * rng.standard_normal(exact.shape)
            made[k] = replace(made[k], tau_sensor=exact + noise)
    return case_of("synthetic", synthetic.arm(), *made)


def segment(k: int = 1) -> Segment:
    """The segment of a recording."""
    (only,) = condition(case().recordings[k], CUTOFF)
    return only


def test_the_sensor_behind_the_gear_carries_it() -> None:
    moved, s = synthetic.motion(21, 0.2, 8.0), segment()
    bodies, arm = s.bodies(synthetic.body()), CorrectedArm(synthetic.arm())
    predicted = link_torque(arm, bodies, s.motion)
    expected = reading(loaded(Truth()), moved, s.motion.t)
    error = (predicted - expected)[s.inner]
    assert np.abs(error).max() < 0.02 * np.abs(expected).max()


def rubbing(**truth: Joints) -> Callable[[], Case]:
    return lambda: case(Truth(**truth))


Built = tuple[Callable[[], Case], list[tuple[str, Any]], float]
DIAGNOSED: dict[str, Built] = {
    "with sensors, both sides of which carry it": (lambda: case(sensors=True), [], 0.0),
    "load friction, no Coulomb friction": (
        *(rubbing(load=(0.0, 0.15, 0.0)), [("load_friction", (2,))]),
        0.15,
    ),
    "Coulomb friction, no load friction": (
        *(rubbing(coulomb=(0.0, 3.0, 0.0)), [("coulomb_friction", (2,))]),
        3.0,
    ),
    "an unknown load on top": (
        *(lambda: case(Truth(mass=1.5, com=(0.2, 0.0, 0.0))), [("payload", ())]),
        1.5,
    ),
}


@pytest.mark.parametrize("label", daily(DIAGNOSED, *list(DIAGNOSED)[:2]))
def test_what_is_found_is_beyond_the_known_load(label: str) -> None:
    """Whole diagnoses of three recordings, of which the second carries 2 kg."""
    make, expected, value = DIAGNOSED[label]
    result = diagnose(make())
    document = result.document
    validate(document)
    assert named(result) == expected
    assert (document["verdict"] == "no_gap") == (not expected)
    carried = [r.get("payload") for r in document["recordings"]]
    assert carried == [None, LOAD.entry(), None]
    assert set(document.get("sides", {}).get("carried_by", ())) <= {"neither"}
    for effect in result.effects:
        first = next(iter(effect.parameters.values()))
        assert first == pytest.approx(value, rel=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("against", [False, True])
def test_a_load_that_is_not_declared_is_a_gap(against: bool, tmp_path: Path) -> None:
    today = case(declared=False)
    found = compared(today, synthetic.case(seed=4), tmp_path) if against else None
    document = (found.diagnosis if found else diagnose(today)).document
    assert document["verdict"] != "no_gap"
    assert against or all("payload" not in r for r in document["recordings"])


def compared(today: Case, before: Case, folder: Path) -> Change:
    return diagnose_change(today, identify_reference(before), folder)


@pytest.mark.parametrize("known", daily(("case", "reference"), "case"))
def test_a_declared_load_is_no_news(known: str, tmp_path: Path) -> None:
    plain, carried = synthetic.case(seed=4), case()
    today, before = (carried, plain) if known == "case" else (plain, carried)
    document = compared(today, before, tmp_path).diagnosis.document
    assert document["verdict"] == "no_gap"


@pytest.mark.nightly
def test_identification_takes_it_out_of_the_torque() -> None:
    """The arm identified on recordings with and without a declared load is the arm without it."""
    few = IdentificationSettings(plain=True)
    told, hidden = (identify(case(declared=known), few) for known in (True, False))
    mass = [float(result.validation[0].every.overall) for result in (told, hidden)]
    assert mass[0] < 0.02 and mass[1] > 2 * mass[0]
    nominal = told.columns.nominal(told.choice.law)
    links = slice(told.columns.links)
    row = told.columns.smooth(segment(0).motion)[:, 1, links]
    difference = row @ (told.physical.value - nominal)[links]
    assert np.abs(difference).max() < 0.03 * np.abs(row @ nominal[links]).max()
