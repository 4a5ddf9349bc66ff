"""Alternatives: which effects may take which place, their probabilities by hand, and the recordings that separate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import selections
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.alternatives import (
    Alternative,
    alternatives,
    equivalents,
    separated_by,
)
from gapscope.diagnosis.thresholds import TEMPER
from gapscope.effects.catalogue import explained
from gapscope.model.terms import Term

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
    others = alternatives(
        selections.selection(FRICTION, evidence=evidence), "coulomb_friction"
    )
    close, none = np.exp(-3.0 * TEMPER), np.exp(-10.0 * TEMPER)
    first, second = others[:2]
    assert (first.effect, first.joints) == ("viscous_friction", (1,))
    assert (first.evidence, second.evidence) == pytest.approx((-3.0, -10.0))
    assert first.probability == pytest.approx(close / (1.0 + close + none))
    assert (second.effect, second.joints) == ("none", ())


def test_better_alternatives_count_as_equals() -> None:
    evidence = scored({frozenset({FRICTION}): 0.0, frozenset(): 30.0})
    (best, *_) = alternatives(
        selections.selection(FRICTION, evidence=evidence), "coulomb_friction"
    )
    assert best.effect == "none" and best.probability == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("found", "other", "share"),
    [
        ("actuator_delay", "actuator_lag", 1 / 3),
        ("actuator_lag", "actuator_delay", 1 / 2),
    ],
)
def test_a_lag_that_does_as_well_as_a_delay_is_half_as_likely(
    found: str, other: str, share: float
) -> None:
    """A lag is found in its place only where the data decide."""
    mine, theirs = term(found, 1), term(other, 1)
    evidence = scored({frozenset({mine}): 9.0, frozenset({theirs}): 9.0})
    (rival, *_) = alternatives(selections.selection(mine, evidence=evidence), found)
    assert rival.effect == other
    assert rival.probability == pytest.approx(share, abs=1e-3)


def test_an_alternative_takes_the_joints_of_the_effect_and_leaves_all_others() -> None:
    tried = []

    def score(terms: frozenset[Term]) -> float:
        tried.append(terms)
        return 0.0

    both = selections.selection(FRICTION, ROTOR, evidence=TableEvidence(score=score))
    tried.clear()
    others = alternatives(both, "coulomb_friction")
    assert all(ROTOR in terms and FRICTION not in terms for terms in tried)
    assert {t.joint for terms in tried for t in terms - {ROTOR}} == {0, 1}
    assert len(others) == len(tried)


def test_effects_on_links_and_effects_that_are_named_are_no_alternatives() -> None:
    both = selections.selection(FRICTION, ROTOR)
    names = {other.effect for other in alternatives(both, "coulomb_friction")}
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
    others = alternatives(found, "actuator_delay")
    evidence = {other.effect: other.evidence for other in others}
    assert evidence["actuator_lag"] == pytest.approx(-2.0 + np.log(0.5) / TEMPER)
    assert evidence["payload"] == -1.0


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
