"""The search on a three-joint arm: what is there, by its name and with its value, and nothing more."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from diagnosis.synthetic import COULOMB, Truth, arm, case, recordings
from sweeps import daily, nightly

from gapscope.diagnosis.diagnose import examine
from gapscope.diagnosis.selection.search import (
    ERRORS,
    EVERYONE,
    nameable,
    search_of,
)
from gapscope.model.design import about
from gapscope.model.difference import Difference
from gapscope.model.terms import Candidate, Terms


@cache
def difference(truth: Truth) -> Difference:
    """What the search finds in three recordings of 6 s."""
    return search_of(arm(), recordings(truth, duration=6.0)).run()


def named(found: Difference) -> dict[tuple[str, int], np.ndarray]:
    values = found.fit.values
    return {(one.effect, one.term.joint): x for one, x in values.items()}


def test_every_hypothesis_counts_with_the_errors_that_suit_it():
    found = difference(Truth())
    assert not named(found)
    levels = found.fit.levels
    assert set(levels) == set(ERRORS)
    totals = [levels[error].total for error in ERRORS]
    # a data sheet that is right has small errors
    assert int(np.argmax(totals)) < len(ERRORS) // 2


@pytest.mark.parametrize(
    ("truth", "name", "joint", "value"),
    [
        ({"coulomb": (0.0, 0.8 * COULOMB[1], 0.0)}, "coulomb_friction", 2, 0.8 * COULOMB[1]),
        nightly({"scale": (0.0, 0.15, 0.0)}, "torque_scale", 2, 0.15),
        nightly({"offset": (0.0, 1.0, 0.0)}, "torque_offset", 2, 1.0),
        nightly({"tilt": (0.05, 0.0)}, "base_tilt", 0, 0.05),
        nightly({"delay": (0.0, 0.0, 0.015)}, "actuator_delay", 3, 0.015),
    ],
)  # fmt: skip
def test_one_effect(truth, name, joint, value):
    one = named(difference(Truth(**truth)))
    assert list(one) == [(name, joint)]
    assert one[name, joint][0] == pytest.approx(value, rel=0.15)


@pytest.mark.parametrize(
    ("truth", "name", "place", "shape", "within", "count"),
    [
        (
            {"ripple": (0.0, 1.5, 0.0), "cycles": 16.0},
            "torque_ripple",
            2,
            (16.0,),
            0.01,
            3,
        ),
        nightly(
            {"drift": (0.0, 0.8, 0.0), "drift_time": 3.0},
            "friction_drift",
            2,
            (3.0,),
            0.2,
            3,
        ),
        nightly(
            {"force": (0.0, 15.0, 0.0), "window": (2.0, 4.0)},
            "external_force",
            0,
            (2.0, 4.0),
            0.1,
            1,
        ),
    ],
)
def test_what_is_searched_is_found(truth, name, place, shape, within, count):
    few = recordings(Truth(**truth), duration=6.0)[:count]
    found = search_of(arm(), few).run()
    (one,) = found.fit.mine
    assert (one.effect, one.term.joint) == (name, place)
    assert found.shapes[one.term] == pytest.approx(shape, rel=within)
    assert all(std > 0 for std in found.found[one.term].deviations)


def test_a_heavier_last_link_is_a_payload():
    found = named(difference(Truth(mass=1.5, com=(0.1, 0.0, 0.05))))
    assert set(found) == {("payload", 0)}
    mass, *moment = found["payload", 0]
    assert mass == pytest.approx(1.5, rel=0.02)
    assert np.array(moment) / mass == pytest.approx([0.1, 0.0, 0.05], abs=0.005)


def test_a_lighter_last_link_is_a_link():
    found = named(difference(Truth(mass=-1.0, com=(0.15, 0.03, 0.0))))
    assert set(found) == {("link_inertia", 3)}


@pytest.mark.parametrize(("mass", "possible"), [(1.0, True), (-1.0, False)])
def test_a_load_is_not_lighter_than_nothing(mass, possible):
    lighter = recordings(Truth(mass=mass, com=(0.15, 0.03, 0.02)), duration=6.0)
    searching = search_of(arm(), lighter)
    searching.unsearched()
    (load,) = (Candidate(t, EVERYONE) for t in Terms(3).of("payload"))
    assert (searching.with_some([load], {}).mine == [load]) == possible


def test_what_makes_an_arm_swing_beyond_all_numbers_is_no_hypothesis(monkeypatch):
    """As the values of a compliant joint did beside much else: they were not a number in the end."""
    searching = search_of(arm(), recordings(Truth(), duration=6.0))
    searching.unsearched()
    (bent, *_) = (Candidate(t, EVERYONE) for t in Terms(3).of("joint_elasticity"))

    def swinging(*given):
        gap, columns = about(*given)
        return 1e200 + gap, columns

    monkeypatch.setattr("gapscope.model.difference.about", swinging)
    fit = searching.with_some([bent], {})
    assert fit.total == -np.inf and all(
        np.isfinite(x).all() for x in fit.values.values()
    )


def test_all_friction_may_be_gone():
    found = named(difference(Truth(coulomb=(0.0, -COULOMB[1], 0.0))))
    assert set(found) == {("coulomb_friction", 2)}
    assert found["coulomb_friction", 2] == pytest.approx(-COULOMB[1], rel=0.05)


def test_a_delay_competes_with_a_lag():
    found = difference(Truth(delay=(0.0, 0.012, 0.0)))
    assert set(named(found)) == {("actuator_delay", 2)}
    rivals = {
        frozenset((one.effect, one.term.joint) for one in some): value
        for some, value in found.sets.items()
    }
    late, lag, none = (
        rivals[frozenset(some)]
        for some in ({("actuator_delay", 2)}, {("actuator_lag", 2)}, ())
    )
    assert late > lag > none == 0.0


def test_two_effects_are_both_found():
    found = named(difference(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5))))
    assert set(found) == {("armature", 2), ("torque_offset", 3)}
    assert found["armature", 2] == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize(
    ("roll", "pitch"),
    [
        (np.pi, 0.0),
        *(
            nightly(*angles)
            for angles in ((-1.4, 0.0), (3.0, 0.2), (0.1, 1.4), (-2.2, 0.7))
        ),
    ],
)
def test_an_arm_that_hangs_or_is_on_a_wall_is_named_as_that(roll: float, pitch: float):
    """No linearisation about the nominal arm reaches so far."""
    found = examine(case(Truth(tilt=(roll, pitch)), duration=6.0))
    assert found.named == ("base_tilt",)
    angles = found.parameters("base_tilt")
    turned = np.array([angles[name]["value"] for name in angles]) - [roll, pitch]
    # half a turn to either side is the same
    assert np.abs(np.angle(np.exp(1j * turned))).max() < 0.02
    assert max(angles[name]["std"] for name in angles) < 0.02


@pytest.mark.parametrize(
    ("truth", "effect", "value"),
    [
        ({"play": (0.008, 0.0, 0.0)}, "backlash", 0.008),
        nightly(
            {"stiffness": (400.0, 0.0, 0.0), "damping": (2.0, 0.0, 0.0)},
            "joint_elasticity",
            1 / 400.0,
        ),
    ],
)
@pytest.mark.parametrize("duration", daily((6.0, 8.0), 6.0))
def test_a_joint_that_rattles_and_one_that_bends(truth, effect, value, duration):
    found = search_of(arm(), recordings(Truth(**truth), duration=duration)).run()
    assert set(named(found)) == {(effect, 1)}
    assert named(found)[effect, 1][0] == pytest.approx(value, rel=0.15)


# Sizes at which effects would be named: what is larger is found, what is smaller is not.


STIFF = Truth(coulomb=(0.0, 3.0, 0.0))


def shown() -> dict[tuple[str, int], dict[str, Any]]:
    every = nameable(difference(STIFF))
    return {(one["effect"], sum(one["joints"])): one for one in every}


@pytest.mark.parametrize("multiple", [0.5, 1.5])
@pytest.mark.parametrize(
    ("effect", "joint", "field"),
    [("viscous_friction", 1, "viscous"), ("torque_offset", 3, "offset")],
)
def test_an_effect_is_found_from_its_size_on(effect, joint, field, multiple):
    size = np.zeros(3)
    size[joint - 1] = multiple * shown()[effect, joint]["half"]
    found = difference(Truth(coulomb=STIFF.coulomb, **{field: tuple(size)}))
    assert ((effect, joint) in named(found)) == (multiple > 1)


def test_nine_of_ten_need_more_than_half_of_them():
    every = [one for one in shown().values() if one["nine_of_ten"] is not None]
    assert len(every) > 10
    assert all(0 < one["half"] < one["nine_of_ten"] for one in every)


def test_what_is_there_already_is_not_asked_again():
    assert ("coulomb_friction", 2) not in shown()
    assert ("coulomb_friction", 1) in shown()


# What form error, and the form of what was found, may hide or pass for.


@pytest.mark.parametrize("late", ["delay", "lag"])
def test_delays_and_lags_of_all_joints_are_told_apart(late: str):
    found = named(difference(Truth(**{late: (0.006, 0.008, 0.012)})))
    assert set(found) == {(f"actuator_{late}", joint) for joint in (1, 2, 3)}
    values = [found[f"actuator_{late}", joint][0] for joint in (1, 2, 3)]
    assert values == pytest.approx([0.006, 0.008, 0.012], rel=0.15)


def power_law(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """8 |dq|^1.3 sgn dq [N m] on joint 2: no law of the catalogue."""
    out = np.zeros_like(q)
    out[:, 1] = 8.0 * np.sign(dq[:, 1]) * np.abs(dq[:, 1]) ** 1.3
    return out


def test_what_the_form_of_a_law_leaves_is_no_second_effect():
    found = named(difference(Truth(extra=power_law)))
    assert set(found) == {("viscous_friction", 2)}
