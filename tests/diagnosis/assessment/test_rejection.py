"""Rejection: terms that do harm on held-out data, and those that stay."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import selections
from selections import term

from gapscope.diagnosis.assessment.rejection import reject
from gapscope.diagnosis.selection.search import Selection
from gapscope.model.terms import Term

FRICTION, ROTOR, OFFSET = (
    term("coulomb_friction", 1),
    term("armature", 2),
    term("encoder_offset", 2),
)
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
    assert rejected({both: [0.1, 0.1]}, FRICTION, ROTOR) == (both, [])


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
