"""What a person could see: how far terms narrow the torque gap, in torque NRMSE."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import VISIBLE_EFFECT, VISIBLE_TERM
from gapscope.model.terms import Term


def visible(model: Model, terms: frozenset[Term]) -> bool:
    """Whether terms instead of the model's close enough of the gap for a person to see it."""
    named = {t.effect for t in model.fit.terms}
    new_effect = any(t.effect not in named for t in terms)
    least = VISIBLE_EFFECT if new_effect else VISIBLE_TERM
    return closed_by(model, model.fit.terms, terms) >= least


def closed_by(model: Model, few: frozenset[Term], many: frozenset[Term]) -> float:
    """How much of the torque NRMSE of some joint more terms close: held out or in sample, whichever is less.

    A slow recording alone may fix a delay so badly that any further term seems to help on the fast one left out;
    fitted to all recordings such a term does nothing. If errors of the nominal inertials hide an effect under a
    wider gap of their own, what it closes once they are removed counts too.
    """
    evidence = model.evidence

    def closed(mean_square: Callable[..., np.ndarray], corrected: bool) -> float:
        few_nrmse, many_nrmse = (
            nrmse(model, mean_square(terms, corrected=corrected))
            for terms in (few, many)
        )
        return float((few_nrmse - many_nrmse).max())

    plain, corrected = (
        min(closed(evidence.held_out_mse, c), closed(evidence.in_sample_mse, c))
        for c in (False, True)
    )
    return max(plain, corrected) if plain > 0 else plain


def closed_between(before: Model, after: Model) -> float:
    """How much of the torque NRMSE of some joint one model closes that another leaves, each by its own values.

    With the errors of the nominal inertials taken out or not, whichever is more.
    """

    def held_out(model: Model, corrected: bool) -> np.ndarray:
        gap = model.evidence.held_out_mse(model.fit.terms, corrected=corrected)
        return nrmse(model, gap)

    return max(
        float((held_out(before, corrected) - held_out(after, corrected)).max())
        for corrected in (False, True)
    )


def nrmse(model: Model, mse: np.ndarray) -> np.ndarray:
    """Torque NRMSE per joint [1], (n,), from the mean square of the gap per fold and joint [N^2 m^2], (F, n)."""
    rows = model.evidence.rows
    mean_square = (mse * rows).sum(axis=0) / rows.sum(axis=0)
    return np.sqrt(mean_square) / model.data.torque_deviation
