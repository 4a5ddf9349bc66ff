"""Models of the synthetic arm before any term is added, for the tests of the selection."""

from __future__ import annotations

from functools import cache

import synthetic
from synthetic import Truth

from gapscope.diagnosis.selection.fitted_model import Model, nominal_model
from gapscope.diagnosis.selection.search import Selection, search
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
    thinned,
)
from gapscope.model.terms import Term


def _folds(truth: Truth) -> tuple[list[list[Segment]], float]:
    case = synthetic.case(truth, seed=5)
    cutoff = position_cutoff(case.recordings)
    folds = [[thinned(s, 100.0) for s in condition(r, cutoff)] for r in case.recordings]
    return folds, min(TORQUE_CUTOFF, cutoff)


@cache
def model(truth: Truth) -> Model:
    """The nominal model of three recordings, 8 s each."""
    folds, cutoff = _folds(truth)
    return nominal_model(synthetic.arm(), synthetic.body(), folds, cutoff)


@cache
def selection(truth: Truth) -> Selection:
    """What the search finds in them."""
    folds, cutoff = _folds(truth)
    return search(synthetic.arm(), synthetic.body(), folds, cutoff)


def term(of: Model, effect: str, joint: int) -> Term:
    """The term of an effect on a joint."""
    return next(t for t in of.terms.of(effect) if t.joint == joint)
