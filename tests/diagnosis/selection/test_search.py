"""The search on a three-joint arm: what is there, by its name and with its value, and nothing more."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.synthetic import COULOMB, Truth, arm, recordings
from small_models import selection
from sweeps import nightly

from gapscope.diagnosis.selection.fitted_model import by_finding
from gapscope.diagnosis.selection.search import ERRORS, difference_of
from gapscope.model.difference import Difference
from gapscope.model.terms import Term, Terms

# What recordings show beside the data sheet.


def difference(truth: Truth) -> Difference:
    """What the search finds in three recordings of 6 s."""
    return difference_of(arm(), recordings(truth, duration=6.0))


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
    found = difference_of(arm(), recordings(Truth(**truth), duration=6.0)[:count])
    (one,) = found.fit.mine
    assert (one.effect, one.term.joint) == (name, place)
    assert found.shapes[one.term] == pytest.approx(shape, rel=within)
    assert all(std > 0 for std in found.found[one.term].deviations)


# The same fitted to folds.


def effects(truth: Truth) -> dict[tuple[str, int], np.ndarray]:
    fit = selection(truth).fit
    return {(t.effect, t.joint): fit.theta[list(t.columns)] for t in fit.terms}


def test_a_healthy_arm_has_no_effect():
    result = selection(Truth())
    assert not result.fit.terms
    assert result.nominal_mse == pytest.approx(result.fit.held_out_mse)


def test_a_heavier_last_link_is_a_payload():
    (name, (mass, *moment)), *others = effects(
        Truth(mass=1.5, com=(0.1, 0.0, 0.05))
    ).items()
    assert name == ("payload", 0) and not others
    assert mass == pytest.approx(1.5, rel=0.02)
    assert np.array(moment) / mass == pytest.approx([0.1, 0.0, 0.05], abs=0.005)


@pytest.mark.nightly
def test_a_lighter_last_link_is_a_link():
    assert set(effects(Truth(mass=-0.6, com=(0.05, 0.0, 0.0)))) == {("link_inertia", 3)}


def test_a_delay_competes_with_a_lag():
    found = selection(Truth(delay=(0.0, 0.012, 0.0)))
    (late,) = found.fit.terms
    assert (late.effect, late.joint) == ("actuator_delay", 2)
    rivals = {
        other.effect: value
        for terms, value in found.competing.items()
        for other in terms
        if late not in terms
    }
    assert rivals["actuator_lag"] < 0


def test_two_effects_are_both_found():
    both = effects(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5)))
    assert set(both) == {("armature", 2), ("torque_offset", 3)}
    assert both["armature", 2] == pytest.approx(0.4, rel=0.1)


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
    found = effects(Truth(tilt=(roll, pitch)))
    assert set(found) == {("base_tilt", 0)}
    turned = found["base_tilt", 0] - [roll, pitch]
    # half a turn to either side is the same
    assert np.abs(np.angle(np.exp(1j * turned))).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "effect", "value"),
    [
        (Truth(play=(0.008, 0.0, 0.0)), "backlash", 0.008),
        nightly(
            Truth(stiffness=(1500.0, 0.0, 0.0), damping=(3.0, 0.0, 0.0)),
            "joint_elasticity",
            1 / 1500.0,
        ),
    ],
)
def test_a_joint_that_rattles_and_one_that_bends(
    truth: Truth, effect: str, value: float
) -> None:
    found = effects(truth)
    assert set(found) == {(effect, 1)}
    assert found[effect, 1][0] == pytest.approx(value, rel=0.15)


# What is named together.


TERMS = Terms(3)


def term(effect: str, joint: int) -> Term:
    return next(t for t in TERMS.of(effect) if t.joint == joint)


def test_terms_are_grouped_by_finding_links_apart() -> None:
    links = {term("link_inertia", 1), term("link_inertia", 2)}
    joints = {term("armature", 1), term("armature", 2)}
    assert sorted(map(len, by_finding(frozenset(links | joints)))) == [1, 1, 2]
    assert frozenset(joints) in by_finding(frozenset(links | joints))
