"""Models of the synthetic arm before any term is added, for the tests of the selection."""

from __future__ import annotations

from functools import cache

import synthetic
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.diagnosis.selection.fitted_model import Model, Selection, nominal_model
from gapscope.diagnosis.selection.search import search
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
)
from gapscope.model.terms import Term


def _folds(case: Case) -> tuple[list[list[Segment]], float]:
    cutoff = position_cutoff(case.recordings)
    folds = [condition(recording, cutoff) for recording in case.recordings]
    return folds, min(TORQUE_CUTOFF, cutoff)


@cache
def model(truth: Truth) -> Model:
    """The nominal model of three recordings, 8 s each."""
    folds, cutoff = _folds(synthetic.case(truth, seed=5))
    return nominal_model(synthetic.arm(), synthetic.body(), folds, cutoff, {})


@cache
def selection(truth: Truth) -> Selection:
    """What the search finds in them."""
    case = synthetic.case(truth, seed=5)
    return search(case.arm, case.recordings, *_folds(case))


def term(of: Model, effect: str, joint: int) -> Term:
    """The term of an effect on a joint."""
    return next(t for t in of.linear.terms.of(effect) if t.joint == joint)
