"""Named or possible: one half of calibrated probability divides, and the least sure goes first."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import selections
import synthetic
from selections import TERMS, TableEvidence, term
from synthetic import Truth

from gapscope.diagnosis.assessment import confidence
from gapscope.diagnosis.assessment.confidence import (
    Alternative,
    Naming,
    Support,
    alternatives,
    conformal_set,
    divide,
    equivalents,
    probability,
    separated_by,
    with_probabilities,
)
from gapscope.diagnosis.assessment.held_out_prediction import (
    ExcessResidual,
    false_discovery_rates,
    log_e_value,
    log_e_values,
    reject,
)
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.selection.search import search
from gapscope.diagnosis.thresholds import (
    FALSE_DISCOVERY_RATE,
    MAX_PROBABILITY,
    MIN_PROBABILITY,
    TEMPER,
)
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    position_cutoff,
)
from gapscope.model.terms import Term

FRICTION, ROTOR = term("coulomb_friction", 1), term("armature", 2)
ALL_EXPLAINED = ExcessResidual(
    before=np.full(2, 0.5),
    after=np.zeros(2),
    ratio=np.ones(2),
    ratio_expected=np.ones(2),
    by_chance=np.ones(2),
    compliant=False,
)


@dataclass(frozen=True)
class HalvingPredictor:
    """Predictor with which every term takes two tenths from the gap of its joint."""

    selection: Selection

    def gap(self, terms: frozenset[Term]) -> Any:
        nrmse = np.full(2, 0.5)
        for found in terms:
            nrmse[found.joint - 1] -= 0.2
        return SimpleNamespace(nrmse=nrmse)


def divided(
    *terms: Term, score: Any, residual: ExcessResidual = ALL_EXPLAINED
) -> Naming:
    healthy = np.full((1, 2), 1e-4)
    evidence = TableEvidence(score=score, expected2=healthy)
    found = selections.selection(
        *terms, evidence=evidence, competing=subsets(frozenset(terms), score)
    )
    return divide(HalvingPredictor(found), residual)  # type: ignore[arg-type]


def subsets(terms: frozenset[Term], score: Any) -> dict[frozenset[Term], float]:
    """Evidence of all parts of some terms over that of all."""
    parts = [
        frozenset(part)
        for count in range(len(terms))
        for part in itertools.combinations(terms, count)
    ]
    return {part: score(part) - score(terms) for part in parts}


def test_what_is_sure_is_named() -> None:
    naming = divided(
        FRICTION, ROTOR, score=lambda t: 100.0 * len(t & {FRICTION, ROTOR})
    )
    assert set(naming.named) == {"coulomb_friction", "armature"}
    assert naming.possible == {} and naming.selection.fit.terms == {FRICTION, ROTOR}
    assert all(sure.probability > 0.9 for sure in naming.named.values())


def test_what_many_others_explain_as_well_is_possible() -> None:
    naming = divided(FRICTION, ROTOR, score=lambda terms: 100.0 * (ROTOR in terms))
    assert set(naming.named) == {"armature"}
    assert naming.possible["coulomb_friction"].probability < 0.5
    assert naming.selection.fit.terms == {ROTOR}


def test_what_is_left_on_its_joint_makes_an_effect_doubtful() -> None:
    """Evidence is sure of both; on joint 1 most of the gap stays all the same."""
    left = ExcessResidual(
        before=np.full(2, 0.5),
        after=np.array([0.5, 0.0]),
        ratio=np.array([7.0, 1.0]),
        ratio_expected=np.array([7.0, 1.0]),
        by_chance=np.ones(2),
        compliant=False,
    )
    score = lambda terms: 100.0 * len(terms & {FRICTION, ROTOR})  # noqa: E731
    naming = divided(FRICTION, ROTOR, score=score, residual=left)
    assert set(naming.possible) == {"coulomb_friction"}
    assert set(naming.named) == {"armature"}


def test_of_two_that_do_as_well_without_each_other_neither_is_sure() -> None:
    """Either explains all, and either alone is as likely as both."""
    naming = divided(
        FRICTION, ROTOR, score=lambda t: 100.0 * bool(t & {FRICTION, ROTOR})
    )
    assert {one.support.margin for one in naming.named.values()} == {np.log(2.0)}


def test_what_cannot_be_without_a_doubtful_one_is_no_surer() -> None:
    """Without friction, which others explain as well, the rotor's value is impossible."""

    @dataclass(frozen=True)
    class Needing(TableEvidence):
        def fit_possible(self, terms: frozenset[Term]) -> Any:
            return self.fit(terms if FRICTION in terms else frozenset())

    score = lambda terms: 100.0 * (ROTOR in terms)  # noqa: E731
    competing = subsets(frozenset({FRICTION, ROTOR}), score)
    found = selections.selection(
        FRICTION, ROTOR, evidence=Needing(score=score), competing=competing
    )
    naming = divide(HalvingPredictor(found), ALL_EXPLAINED)  # type: ignore[arg-type]
    assert naming.named == {} and set(naming.possible) == {
        "coulomb_friction",
        "armature",
    }
    assert all(sure.probability < 0.5 for sure in naming.possible.values())


def test_nothing_found_is_nothing_named() -> None:
    naming = divided(score=lambda terms: 0.0)
    assert naming.named == {} and naming.possible == {}


def test_a_payload_shares_its_probability_with_the_changed_last_link() -> None:
    payload = term("payload")
    naming = divided(payload, score=lambda terms: 1e3 * (payload in terms))
    sure = naming.named["payload"]
    link = next(a for a in sure.alternatives if a.effect == "link_inertia")
    assert link.equivalent and link.probability >= 0.05
    assert sure.probability + link.probability == pytest.approx(0.995, abs=0.02)


# Calibrated probabilities over hand-made values: the product of both reasons, its bounds, and sets of names.


SURE = Support(
    margin=50.0,
    closed=0.01,
    left=0.0,
    times_floor=1.0,
    times_expected=1.0,
    effects=1,
    nominal=0.01,
)
EVEN = Support(
    margin=0.0,
    closed=0.01,
    left=0.0,
    times_floor=1.0,
    times_expected=1.0,
    effects=1,
    nominal=0.01,
)
NEUTRAL = {
    "intercept": 0.0,
    "weights": [0.0] * 6,
    "effects": {"armature": np.log(3.0)},
    "temper": 0.0,
    "unlisted": 1.0,
    "level": 0.9,
    "expected": 0.05,
}


def alternative(effect: str, evidence: float, probability: float = 0.0) -> Alternative:
    return Alternative(effect, (), probability, evidence)


class TestProbability:
    def test_it_is_the_product_of_evidence_and_what_is_learnt(self) -> None:
        assert probability("backlash", SURE, NEUTRAL) == pytest.approx(0.5)
        assert probability("armature", SURE, NEUTRAL) == pytest.approx(0.75)
        assert probability("armature", EVEN, NEUTRAL) == pytest.approx(0.375)

    def test_an_arm_unlike_all_that_were_seen_makes_it_less_sure(self) -> None:
        """z = 1 and V = 1 / 0.3: ln 3 over sqrt(1 + pi / 2.4), in favour of the cause as against it."""
        factor = np.sqrt(1.0 + np.pi / 2.4)
        for z, name in ((np.log(3.0), "armature"), (-np.log(3.0), "worse")):
            values = NEUTRAL | {"effects": {name: z}}
            unlike = replace(SURE, expected=0.05 * np.e)
            expected = 1.0 / (1.0 + np.exp(-z / factor))
            assert probability(name, unlike, values) == pytest.approx(expected)
            # one that leaves less than those that were seen is like them
            like = replace(SURE, expected=0.01)
            assert probability(name, like, values) == probability(name, SURE, values)

    def test_it_is_bounded(self) -> None:
        high, low = (NEUTRAL | {"intercept": z} for z in (99.0, -99.0))
        assert probability("backlash", SURE, high) == MAX_PROBABILITY
        assert probability("backlash", SURE, low) == MIN_PROBABILITY

    def test_the_fitted_values_know_more_with_more_support(self) -> None:
        strong = Support(100.0, 0.3, 0.02, 1.0, 1.0, 1, 0.01)
        weak = Support(2.0, 0.012, 0.9, 3.0, 3.0, 4, 0.06)
        assert probability("armature", strong) > probability("armature", weak)


def test_features_by_hand() -> None:
    support = Support(
        margin=np.e - 1.0,
        closed=0.01 * np.e,
        left=1.7,
        times_floor=99.0,
        times_expected=np.e,
        effects=9,
        nominal=0.03,
    )
    assert support.features() == pytest.approx([0.5, 1.0, 1.0, 1.0, 4.0, 1.0])


class TestAlternatives:
    def test_a_known_cause_leaves_its_rest_by_evidence(self) -> None:
        """p = p_evidence: exp(tau l) / (1 + sum)."""
        others = [alternative("a", -5.0), alternative("b", 2.0)]
        a, b = np.exp(-5.0 * TEMPER), 1.0
        ranked = with_probabilities(others, EVEN.evidence, EVEN, NEUTRAL)
        assert [r.effect for r in ranked] == ["b", "a"]
        assert ranked[0].probability == pytest.approx(b / (1.0 + a + b))
        assert ranked[1].probability == pytest.approx(a / (1.0 + a + b))

    def test_an_unknown_cause_leaves_a_part_to_none_of_those_listed(self) -> None:
        """With p = 0, two alternatives and one unlisted weigh alike."""
        others = [alternative("a", -5.0), alternative("b", -90.0)]
        ranked = with_probabilities(others, 0.0, SURE, NEUTRAL)
        assert [r.probability for r in ranked] == pytest.approx([1 / 3, 1 / 3])

    def test_all_together_share_no_more_than_one(self) -> None:
        others = [alternative(name, -3.0 * k) for k, name in enumerate("abcd")]
        margin = -np.log(np.exp([TEMPER * other.evidence for other in others]).sum())
        support = replace(EVEN, margin=float(margin))
        for share in (0.0, 0.4, 1.0):
            p = share * support.evidence
            ranked = with_probabilities(others, p, support, NEUTRAL)
            total = p + sum(r.probability for r in ranked)
            # at 1 nothing is left to causes that are not listed
            assert total <= 1.0 + 1e-12
            assert (total == pytest.approx(1.0)) == (share == 1.0)


class TestSets:
    @pytest.fixture(autouse=True)
    def level(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(confidence, "fitted", lambda: NEUTRAL)

    def test_a_sure_effect_stands_alone(self) -> None:
        assert conformal_set("a", 0.9, [alternative("b", 0.0, 0.1)]) == ["a"]

    def test_names_are_added_until_the_level_is_reached(self) -> None:
        others = [alternative(n, 0.0, p) for n, p in (("b", 0.3), ("c", 0.2))]
        assert conformal_set("a", 0.5, others) == ["a", "b", "c"]
        assert conformal_set("a", 0.65, others) == ["a", "b"]

    def test_what_is_missing_is_unknown(self) -> None:
        others = [alternative("b", 0.0, 0.2), alternative("c", 0.0, 0.005)]
        assert conformal_set("a", 0.5, others) == ["a", "b", "unknown"]


# Alternatives: which effects may take which place, their probabilities by hand, and the recordings that separate.


VISCOUS, SECOND = term("viscous_friction", 1), term("coulomb_friction", 2)


def rivals(*found: Term, sets: dict[tuple[Term, ...], float]) -> list[Alternative]:
    """Alternatives to Coulomb friction, by the evidence of sets over that of the set found."""
    competing = {frozenset(some): value for some, value in sets.items()}
    searched = selections.selection(*found, competing=competing)
    return alternatives(searched, FRICTION.finding)


def test_probabilities_follow_from_tempered_evidence() -> None:
    first, second = rivals(FRICTION, sets={(VISCOUS,): -3.0, (): -10.0})
    close, none = np.exp(-3.0 * TEMPER), np.exp(-10.0 * TEMPER)
    assert (first.effect, first.joints) == ("viscous_friction", (1,))
    assert (first.evidence, second.evidence) == pytest.approx((-3.0, -10.0))
    assert first.probability == pytest.approx(close / (1.0 + close + none))
    assert (second.effect, second.joints) == ("none", ())


def test_better_alternatives_count_as_equals() -> None:
    (best,) = rivals(FRICTION, sets={(): 30.0})
    assert best.effect == "none" and best.probability == pytest.approx(0.5)


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
        (term("payload"), ROTOR): -4.0,
    }
    (only,) = rivals(FRICTION, ROTOR, sets=sets)
    assert (only.effect, only.joints, only.evidence) == ("payload", (), -4.0)


class TestEquivalents:
    """Payload and changed last link are one body: whichever is named, the other is listed."""

    def test_a_payload_may_be_a_changed_last_link(self) -> None:
        (other,) = equivalents(selections.selection(term("payload")), "payload")
        assert other.effect == "link_inertia" and other.equivalent
        assert 0.05 <= other.probability <= 0.15

    @pytest.mark.parametrize(("mass", "least"), [(0.5, 0.3), (-0.5, 0.05)])
    def test_a_changed_last_link_may_be_a_payload(
        self, mass: float, least: float
    ) -> None:
        """A load of another form than a point is likely; one of negative mass is hardly one."""
        link = term("link_inertia", selections.JOINTS)
        theta = np.zeros(selections.TERMS.size)
        theta[link.columns[0]] = mass
        found = selections.selection(link)
        found = replace(found, fit=replace(found.fit, theta=theta))
        (other,) = equivalents(found, link.finding)
        assert other.effect == "payload" and least <= other.probability < 0.5
        others = {rival.effect for rival in alternatives(found, link.finding)}
        assert "payload" not in others

    def test_other_effects_have_none(self) -> None:
        assert equivalents(selections.selection(FRICTION), "coulomb_friction") == []
        first = term("link_inertia", 1)
        assert equivalents(selections.selection(first), first.finding) == []

    def test_no_motion_separates_them(self) -> None:
        (other,) = equivalents(selections.selection(term("payload")), "payload")
        assert "no motion" in separated_by("payload", other)


def rival(effect: str) -> Alternative:
    return Alternative(effect, (), 0.1, -1.0)


def test_a_pair_is_separated_by_the_same_recording_both_ways() -> None:
    assert separated_by("actuator_delay", rival("actuator_lag")) == separated_by(
        "actuator_lag", rival("actuator_delay")
    )
    assert "longer recording" in separated_by("armature", rival("none"))
    assert "known payload" in separated_by("armature", rival("friction_drift"))


# Rejection: terms that do harm on held-out data, and those that stay.


OFFSET = term("encoder_offset", 2)
Gaps = dict[frozenset[Term], list[float]]


@dataclass(frozen=True)
class TablePredictor:
    """Predictor whose gaps are given; sets that are not listed have the gap of the nominal arm."""

    selection: Selection
    gaps: Gaps

    def of(self, selection: Selection) -> TablePredictor:
        return TablePredictor(selection, self.gaps)

    def gap(self, terms: frozenset[Term]) -> Any:
        return SimpleNamespace(nrmse=np.array(self.gaps.get(terms, [0.5, 0.5])))


def rejected(gaps: Gaps, *terms: Term) -> tuple[frozenset[Term], list[Any]]:
    found = selections.selection(*terms)
    selection, rejections = reject(TablePredictor(found, gaps))  # type: ignore[arg-type]
    return selection.fit.terms, rejections


def test_effects_that_close_the_gap_stay() -> None:
    both = frozenset({FRICTION, ROTOR})
    assert rejected({both: [0.1, 0.1]}, FRICTION, ROTOR) == (
        both,
        [],
    )


def test_the_term_that_widens_a_joint_goes() -> None:
    both = frozenset({FRICTION, ROTOR})
    gaps = {both: [0.1, 0.6], frozenset({FRICTION}): [0.1, 0.5]}
    kept, (rejection,) = rejected(gaps, FRICTION, ROTOR)
    assert kept == {FRICTION} and rejection.terms == {ROTOR}
    assert rejection.reason == "widens the gap of joint 2 on unseen data"
    assert abs(rejection.cost - 0.1) < 1e-12


def test_a_term_of_another_joint_goes_only_if_it_reaches_it() -> None:
    """Joint 1 gets wider with all, and each term without the other leaves it alone."""
    for other, goes in ((ROTOR, False), (OFFSET, True)):
        both = frozenset({FRICTION, other})
        gaps = {
            both: [0.7, 0.1],
            frozenset({FRICTION}): [0.4, 0.5],
            frozenset({other}): [0.6, 0.1],
        }
        kept, rejections = rejected(gaps, FRICTION, other)
        assert (other not in kept) == goes
        assert rejections[0].terms == ({other} if goes else {FRICTION})


def test_a_widening_too_small_to_see_is_let_pass() -> None:
    terms = frozenset({FRICTION})
    assert rejected({terms: [0.509, 0.5]}, FRICTION)[1] == []


# One e-value by hand: quadratic losses of one and of two values, fitted on one half and tested on the other.


TESTED, OTHER = term("coulomb_friction", 1), term("viscous_friction", 1)


def quadratic(values: dict[Term, tuple[float, float]], constant: float) -> np.ndarray:
    """L with the loss sum (a theta^2 / 2 - b theta) + constant / 2, from a and b of each term."""
    out = np.zeros((TERMS.size + 1, TERMS.size + 1))
    for chosen, (a, b) in values.items():
        (place,) = chosen.columns
        out[place, place] = a
        out[place, -1] = out[-1, place] = b
    out[-1, -1] = constant
    return out


def test_a_value_that_both_halves_agree_on() -> None:
    """Fitted 1 on A; on B the loss falls from 0 to 4 / 2 - 3 = -1."""
    fitted = quadratic({TESTED: (2.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, 3.0)}, 7.0)
    terms = frozenset({TESTED})
    assert log_e_value(terms, terms, fitted, tested) == pytest.approx(1.0)


def test_a_value_that_the_other_half_contradicts() -> None:
    """Fitted 1 on A; on B the loss rises from 0 to 4 / 2 + 3 = 5."""
    fitted = quadratic({TESTED: (2.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, -3.0)}, 7.0)
    terms = frozenset({TESTED})
    assert log_e_value(terms, terms, fitted, tested) == pytest.approx(-5.0)


def test_without_the_part_all_others_may_fit_the_tested_half() -> None:
    """The other value, 2 on A, costs 6 / 2 * 4 - 6 * 2 = 0 on B; fitted to B, 1, it gains 6^2 / 6 / 2 = 3."""
    fitted = quadratic({TESTED: (2.0, 2.0), OTHER: (1.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, 3.0), OTHER: (6.0, 6.0)}, 7.0)
    both = frozenset({TESTED, OTHER})
    part = frozenset({TESTED})
    assert log_e_value(both, part, fitted, tested) == pytest.approx(1.0 - 3.0)


# Significance by split samples: e-values of effects that are there and of some that are not, and their rates.


@cache
def found(truth: Truth) -> Selection:
    case = synthetic.case(truth, seed=5)
    cutoff = position_cutoff(case.recordings)
    folds = [condition(r, cutoff) for r in case.recordings]
    return search(case.arm, case.recordings, folds, min(TORQUE_CUTOFF, cutoff))


HEALTHY, HEAVY = Truth(), Truth(armature=(0.0, 0.4, 0.0), coulomb=(1.0, 0.0, 0.0))


def with_terms(of: Selection, effect: str, joint: int) -> Selection:
    """The same with one more term that nothing asked for."""
    term = next(t for t in of.evidence.terms.of(effect) if t.joint == joint)
    return replace(of, fit=of.evidence.fit(of.fit.terms | {term}))


def test_effects_that_are_there_are_borne_out_by_both_halves() -> None:
    values = log_e_values(found(HEAVY))
    assert (
        set(values) == {"armature", "coulomb_friction"} and min(values.values()) > 40.0
    )
    assert max(false_discovery_rates(values).values()) < 1e-6


@pytest.mark.parametrize(
    "effect",
    [
        "torque_offset",
        "viscous_friction",
        "armature",
        "parallel_spring",
        "torque_scale",
    ],
)
@pytest.mark.parametrize("joint", [1, 2, 3])
def test_effects_that_are_not_there_are_not(effect: str, joint: int) -> None:
    """E[e] <= 1: values of 20 / 0.05, which a single discovery needs, come up once in 400 at most."""
    values = log_e_values(with_terms(found(HEALTHY), effect, joint))
    assert values[effect] < np.log(20 / FALSE_DISCOVERY_RATE)


def test_what_is_there_stays_confirmed_beside_what_is_not() -> None:
    rates = false_discovery_rates(
        log_e_values(with_terms(found(HEAVY), "torque_offset", 3))
    )
    assert {name for name, rate in rates.items() if rate <= FALSE_DISCOVERY_RATE} == {
        "armature",
        "coulomb_friction",
    }


class TestRates:
    def test_worked_by_hand(self) -> None:
        """Of 21 the k-th largest e counts 21 / k / e; where a smaller one would be kept, so would a larger one."""
        rates = false_discovery_rates({"b": 5.2, "a": 10.0, "c": 5.5}, tried=21)
        assert rates["a"] == pytest.approx(21 * np.exp(-10.0))
        assert rates["b"] == pytest.approx(21 / 3 * np.exp(-5.2))
        assert rates["c"] == pytest.approx(
            21 / 3 * np.exp(-5.2)
        )  # less than its own, 21 / 2 exp(-5.5)

    def test_bounded_whatever_the_values(self) -> None:
        assert false_discovery_rates({"a": -1e6, "b": 1e6}) == {"a": 1.0, "b": 0.0}
        assert false_discovery_rates({}) == {}

    def test_more_tried_is_harder(self) -> None:
        few, many = (
            false_discovery_rates({"a": 6.0}, tried)["a"] for tried in (1, 100)
        )
        assert many == pytest.approx(100 * few)
