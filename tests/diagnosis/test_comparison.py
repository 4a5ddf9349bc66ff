"""How sure findings are, what may be in their place, and how well their values are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.recording import Recording
from gapscope.diagnosis.comparison import (
    SAMPLING_SKEW,
    Alternative,
    Comparison,
    names_of,
    separated_by,
)
from gapscope.diagnosis.selection.search import EVERYONE, search_of
from gapscope.model.difference import Difference
from gapscope.model.terms import Candidate, Term, Terms

TERMS = Terms(synthetic.N)
Sets = Mapping[tuple[Term, ...], float]


def term(effect: str, joint: int = 0) -> Term:
    """The term of an effect on a joint, or on the arm."""
    return next(t for t in TERMS.of(effect) if t.joint == joint)


FRICTION, SECOND = term("coulomb_friction", 1), term("coulomb_friction", 2)
VISCOUS, ROTOR = term("viscous_friction", 1), term("armature", 2)
LOAD, LINK = term("payload"), term("link_inertia", 3)

# Sets of terms with log odds that are given.


@cache
def nothing() -> Difference:
    """A healthy arm of which nothing was looked for."""
    recordings = synthetic.recordings(Truth(), duration=6.0)
    return search_of(synthetic.arm(), recordings).unsearched()


def compared(*found: Term, sets: Sets) -> Comparison:
    """A comparison that found some terms, with log odds of sets of terms."""
    odds = {
        frozenset(Candidate(t, EVERYONE) for t in some): value
        for some, value in sets.items()
    }
    mine = tuple(Candidate(t, EVERYONE) for t in found)
    fit = replace(nothing().fit, chosen=mine)
    return Comparison(None, replace(nothing(), fit=fit, sets=odds), 0)


def test_probabilities_are_summed_over_the_sets_that_hold_a_finding() -> None:
    """On whatever joint: 3 + 1 + 1 parts of 8 have Coulomb friction, 1 part the rotor."""
    sets = {(): 2.0, (FRICTION,): 3.0, (SECOND,): 1.0, (FRICTION, ROTOR): 1.0}
    logs = {some: float(np.log(parts)) for some, parts in sets.items()}
    found = compared(FRICTION, ROTOR, sets=logs)
    assert found.probabilities["coulomb_friction"] == pytest.approx(5 / 7)
    assert found.probabilities["armature"] == pytest.approx(1 / 7)
    assert found.log_odds("coulomb_friction") == pytest.approx(np.log(5 / 2))
    assert (found.named, found.possible) == (("coulomb_friction",), ("armature",))


def rivals(*found: Term, sets: Sets) -> list[Alternative]:
    """Alternatives to the finding of the first term; the set found has log odds of 0."""
    return compared(*found, sets={found: 0.0, **sets}).alternatives(found[0].finding)


def test_alternatives_are_as_likely_as_their_sets() -> None:
    first, second = rivals(FRICTION, sets={(VISCOUS,): -1.0, (): -3.0})
    close, none = np.exp([-1.0, -3.0])
    assert (first.effect, first.joints) == ("viscous_friction", (1,))
    assert (first.evidence, second.evidence) == pytest.approx((-1.0, -3.0))
    assert first.probability == pytest.approx(close / (1.0 + close + none))
    assert (second.effect, second.joints) == ("none", ())


def test_what_joints_lose_one_by_one_adds_up() -> None:
    """Viscous friction was tried on the first joint alone: on the second nothing stands for it."""
    sets = {(VISCOUS, SECOND): -3.0, (SECOND,): -20.0, (FRICTION,): -8.0}
    evidence = {one.effect: one.evidence for one in rivals(FRICTION, SECOND, sets=sets)}
    assert evidence == {"viscous_friction": -11.0, "none": -28.0}


def test_what_is_no_alternative() -> None:
    """Another joint, a link, a name that is given already, and sets that lose something else as well."""
    sets = {
        (term("viscous_friction", 2), ROTOR): -1.0,
        (term("link_inertia", 1), ROTOR): -1.0,
        (term("armature", 1), ROTOR): -1.0,
        (VISCOUS,): -1.0,
        (FRICTION, ROTOR, VISCOUS): 9.0,
        (LOAD, ROTOR): -4.0,
    }
    (only,) = rivals(FRICTION, ROTOR, sets=sets)
    assert (only.effect, only.joints, only.evidence) == ("payload", (), -4.0)


@pytest.mark.parametrize(("one", "other"), [(LOAD, LINK), (LINK, LOAD)])
def test_a_load_and_the_last_link_are_one_body(one: Term, other: Term) -> None:
    sets = {(other,): -2.0, (term("link_inertia", 1),): -1.0, (VISCOUS,): -4.0}
    first, *_ = found = rivals(one, sets=sets)
    assert (first.effect, first.equivalent) == (other.effect, True)
    assert "no motion" in separated_by(one.effect, first)
    assert not any(rival.equivalent for rival in found[1:])


def alternative(effect: str, probability: float = 0.1) -> Alternative:
    return Alternative(effect, (), probability, -1.0)


def test_a_pair_is_separated_by_the_same_recording_both_ways() -> None:
    pair = "actuator_delay", "actuator_lag"
    one, other = (separated_by(a, alternative(b)) for a, b in (pair, pair[::-1]))
    assert one == other
    assert "longer recording" in separated_by("armature", alternative("none"))
    assert "known payload" in separated_by("armature", alternative("friction_drift"))


def test_names_are_added_until_they_hold_nine_of_ten() -> None:
    others = [alternative("b", 0.3), alternative("c", 0.05)]
    assert names_of("a", 0.9, others) == ["a"]
    assert names_of("a", 0.65, others) == ["a", "b"]
    assert names_of("a", 0.5, others) == ["a", "b", "c", "unknown"]


# Values of cases, against the truth.


RIPPLE = Truth(ripple=(0.0, 1.5, 0.0), cycles=16.0)
LATE = Truth(delay=(0.0, 0.012, 0.0))
STIFF = Truth(coulomb=(0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("truth", "finding", "name", "value"),
    [
        (STIFF, "coulomb_friction", "torque", 1.0),
        (LATE, "actuator_delay", "delay", 0.012),
        (RIPPLE, "torque_ripple", "cycles", 16.0),
    ],
)
def test_an_interval_holds_the_truth_and_is_narrow(truth, finding, name, value) -> None:
    entry = synthetic.examined(truth, 5).parameters(finding)[name]
    half = 1.96 * np.ravel(entry["std"])
    assert np.abs(np.ravel(entry["value"]) - value) < half < 0.2 * value
    # a delay is uncertain by the skew of sampling too
    assert finding != "actuator_delay" or entry["std"][0] >= SAMPLING_SKEW


def searched(*recordings: Recording) -> Comparison:
    return Comparison(None, search_of(synthetic.arm(), recordings).run(), 0)


def test_intervals_widen_if_recordings_disagree() -> None:
    same = synthetic.recordings(STIFF)
    other = synthetic.recordings(Truth(coulomb=(0.0, 1.6, 0.0)))[2]
    narrow, wide = (
        searched(*same[:2], last).parameters("coulomb_friction")["torque"]["std"][0]
        for last in (same[2], other)
    )
    assert wide > 1.4 * narrow


def test_a_load_is_less_certain_on_an_arm_whose_links_are_off() -> None:
    right = Truth(mass=1.5, com=(0.1, 0.0, 0.05))
    wrong = replace(right, link=2, link_mass=0.4, link_com=(0.0, 0.0, 0.02))
    narrow, wide = (
        searched(*synthetic.recordings(truth)).parameters("payload")["mass"]
        for truth in (right, wrong)
    )
    assert wide["std"] > 2.0 * narrow["std"]
    for mass in (narrow, wide):
        assert abs(mass["value"] - 1.5) < 1.96 * mass["std"]
