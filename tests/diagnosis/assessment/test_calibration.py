"""Calibrated probabilities over hand-made values: the product of both reasons, its bounds, and sets of names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.diagnosis.assessment import calibration
from gapscope.diagnosis.assessment.alternatives import Alternative
from gapscope.diagnosis.assessment.calibration import (
    Support,
    conformal_set,
    probability,
    with_probabilities,
)
from gapscope.diagnosis.thresholds import (
    LEAST_PROBABILITY,
    MOST_PROBABILITY,
    TEMPER,
)

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
        assert probability("backlash", SURE, high) == MOST_PROBABILITY
        assert probability("backlash", SURE, low) == LEAST_PROBABILITY

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
        monkeypatch.setattr(calibration, "fitted", lambda: NEUTRAL)

    def test_a_sure_effect_stands_alone(self) -> None:
        assert conformal_set("a", 0.9, [alternative("b", 0.0, 0.1)]) == ["a"]

    def test_names_are_added_until_the_level_is_reached(self) -> None:
        others = [alternative(n, 0.0, p) for n, p in (("b", 0.3), ("c", 0.2))]
        assert conformal_set("a", 0.5, others) == ["a", "b", "c"]
        assert conformal_set("a", 0.65, others) == ["a", "b"]

    def test_what_is_missing_is_unknown(self) -> None:
        others = [alternative("b", 0.0, 0.2), alternative("c", 0.0, 0.005)]
        assert conformal_set("a", 0.5, others) == ["a", "b", "unknown"]
