"""Named or possible: one half of calibrated probability divides, and the least sure goes first."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import selections
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.excess_residual import ExcessResidual
from gapscope.diagnosis.assessment.naming import Naming, divide
from gapscope.diagnosis.selection.search import Selection
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
    found = selections.selection(*terms, evidence=evidence)
    return divide(HalvingPredictor(found), residual)  # type: ignore[arg-type]


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


def test_of_two_that_do_as_well_without_each_other_one_stays() -> None:
    """Either explains all: with both, none of them is needed; with one, it is."""
    naming = divided(
        FRICTION, ROTOR, score=lambda t: 100.0 * bool(t & {FRICTION, ROTOR})
    )
    assert len(naming.named) == 1 and len(naming.possible) == 1


def test_what_cannot_be_without_a_doubtful_one_is_no_surer() -> None:
    """Without friction, which others explain as well, the rotor's value is impossible."""

    @dataclass(frozen=True)
    class Needing(TableEvidence):
        def fit_possible(self, terms: frozenset[Term]) -> Any:
            return self.fit(terms if FRICTION in terms else frozenset())

    evidence = Needing(score=lambda terms: 100.0 * (ROTOR in terms))
    found = selections.selection(FRICTION, ROTOR, evidence=evidence)
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
