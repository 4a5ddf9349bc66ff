"""Significance by split samples: e-values of effects that are there and of some that are not, and their rates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.diagnosis.assessment.significance import (
    false_discovery_rates,
    log_e_values,
)
from gapscope.diagnosis.selection.search import Selection, search
from gapscope.diagnosis.thresholds import FALSE_DISCOVERY_RATE
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
)


@cache
def folds(truth: Truth) -> tuple[list[list[Segment]], float]:
    case = synthetic.case(truth, seed=5)
    cutoff = position_cutoff(case.recordings)
    return [condition(r, cutoff) for r in case.recordings], min(TORQUE_CUTOFF, cutoff)


@cache
def found(truth: Truth) -> Selection:
    return search(synthetic.arm(), synthetic.body(), *folds(truth))


HEALTHY, HEAVY = Truth(), Truth(armature=(0.0, 0.4, 0.0), coulomb=(1.0, 0.0, 0.0))


def with_terms(of: Selection, effect: str, joint: int) -> Selection:
    """The same with one more term that nothing asked for."""
    term = next(t for t in of.evidence.terms.of(effect) if t.joint == joint)
    return replace(of, fit=of.evidence.fit(of.fit.terms | {term}))


def test_effects_that_are_there_are_borne_out_by_both_halves() -> None:
    values = log_e_values(found(HEAVY))
    assert (
        set(values) == {"armature", "coulomb_friction"} and min(values.values()) > 50.0
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
