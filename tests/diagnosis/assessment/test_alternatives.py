"""Alternatives: which effects may take which place, their probabilities by hand, and the recordings that separate."""

from __future__ import annotations

import numpy as np
import pytest
import selections
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.alternatives import alternatives, separated_by
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.thresholds import TEMPER
from gapscope.effects.catalogue import explained

FRICTION, ROTOR = term("coulomb_friction", 1), term("armature", 2)
FAR = -1e4
"""Evidence of what is no alternative [nats]."""


def scored(table: dict[frozenset[Term], float]) -> TableEvidence:
    return TableEvidence(score=lambda terms: table.get(terms, FAR))


def test_probabilities_follow_from_tempered_evidence() -> None:
    viscous = term("viscous_friction", 1)
    evidence = scored(
        {
            frozenset({FRICTION}): 50.0,
            frozenset({viscous}): 47.0,
            frozenset(): 40.0,
        }
    )
    probability, others = alternatives(
        selections.selection(FRICTION, evidence=evidence), "coulomb_friction"
    )
    close, none = np.exp(-3.0 * TEMPER), np.exp(-10.0 * TEMPER)
    assert probability == pytest.approx(1.0 / (1.0 + close + none))
    first, second = others[:2]
    assert (first.effect, first.joints) == ("viscous_friction", (1,))
    assert (first.evidence, second.evidence) == pytest.approx((-3.0, -10.0))
    assert first.probability == pytest.approx(close / (1.0 + close + none))
    assert (second.effect, second.joints) == ("none", ())


def test_better_alternatives_count_as_equals() -> None:
    evidence = scored({frozenset({FRICTION}): 0.0, frozenset(): 30.0})
    probability, (best, *_) = alternatives(
        selections.selection(FRICTION, evidence=evidence), "coulomb_friction"
    )
    assert best.effect == "none" and probability == pytest.approx(0.5)


def test_an_alternative_takes_the_joints_of_the_effect_and_leaves_all_others() -> None:
    tried = []

    def score(terms: frozenset[Term]) -> float:
        tried.append(terms)
        return 0.0

    both = selections.selection(FRICTION, ROTOR, evidence=TableEvidence(score=score))
    tried.clear()
    _, others = alternatives(both, "coulomb_friction")
    assert all(ROTOR in terms and FRICTION not in terms for terms in tried)
    assert {t.joint for terms in tried for t in terms - {ROTOR}} == {0, 1}
    assert len(others) == len(tried)


def test_effects_on_links_and_effects_that_are_named_are_no_alternatives() -> None:
    both = selections.selection(FRICTION, ROTOR)
    names = {other.effect for other in alternatives(both, "coulomb_friction")[1]}
    assert not names & {"link_inertia", "armature", "coulomb_friction"}
    assert names - {"none"} <= {effect.name for effect in explained()}


def test_what_the_search_compared_counts_more_than_the_linearisation() -> None:
    found = selections.selection(
        term("actuator_delay", 1),
        evidence=scored({}),
        contested={
            ("actuator_delay", "actuator_lag"): -2.0,
            ("actuator_delay", "payload"): -1.0,
            ("another", "actuator_lag"): 9.0,
        },
    )
    _, others = alternatives(found, "actuator_delay")
    evidence = {other.effect: other.evidence for other in others}
    assert evidence["actuator_lag"] == -2.0 and evidence["payload"] == -1.0


def test_a_pair_is_separated_by_the_same_recording_both_ways() -> None:
    assert separated_by("actuator_delay", "actuator_lag") == separated_by(
        "actuator_lag", "actuator_delay"
    )
    assert "longer recording" in separated_by("armature", "none")
    assert "known payload" in separated_by("armature", "friction_drift")
