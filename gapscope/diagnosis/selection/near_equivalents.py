"""Effects that look alike to first order, compared each around its own values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.selection.delay_or_lag import DELAY, lag_over_delay
from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.moves import near_equivalent_pairs
from gapscope.diagnosis.selection.visibility import nrmse
from gapscope.diagnosis.thresholds import (
    DECISIVE_EVIDENCE,
    DECISIVE_NRMSE,
    UNDECIDED_EVIDENCE,
)


class Comparison(NamedTuple):
    """Outcome of comparisons.

    Attributes:
        model: the model that is kept.
        contested: by effect kept and its rival, the evidence of the rival less that of the effect kept [nats].
    """

    model: Model
    contested: Mapping[tuple[str, str], float]


def compare_near_equivalents(model: Model) -> Comparison:
    """Refit each near-equivalent effect and keep the better.

    The second of a pair is named only if it is decisively better; if neither is, both stay open.
    """
    contested: dict[tuple[str, str], float] = {}
    for common, rare in near_equivalent_pairs():
        held = {t.effect for t in model.fit.terms} & {common, rare}
        if len(held) == 1:
            model, outcome = _compare(model, held.pop(), common, rare)
            contested.update(outcome)
    return Comparison(model, contested)


def _compare(model: Model, chosen: str, common: str, rare: str) -> Comparison:
    """The model with one of two effects, each on the joints of the one that is chosen."""
    other = rare if chosen == common else common
    models = {chosen: model, other: _renamed(model, chosen, other)}
    # delay and lag differ in their second order in time, which needs no threshold
    gain = lag_over_delay(models[common]) if common == DELAY else None
    if gain is not None:
        winner, loser = (rare, common) if gain > 0 else (common, rare)
        return Comparison(models[winner], {(winner, loser): -abs(gain)})
    gain = models[common].gain_of(models[rare])
    gaps = {name: nrmse(one, one.fit.held_out_mse) for name, one in models.items()}
    apart = float(np.abs(gaps[rare] - gaps[common]).max())
    decisive = abs(gain) > DECISIVE_EVIDENCE and apart > DECISIVE_NRMSE
    winner, loser = (rare, common) if decisive and gain > 0 else (common, rare)
    evidence = -abs(gain) if decisive else UNDECIDED_EVIDENCE
    return Comparison(models[winner], {(winner, loser): evidence})


def _renamed(model: Model, effect: str, other: str) -> Model:
    """The model with another effect on the joints of one of its effects."""
    mine = {t for t in model.fit.terms if t.effect == effect}
    joints = {t.joint for t in mine}
    put = {t for t in model.terms.open if t.effect == other and t.joint in joints}
    return fit_terms(model, (model.fit.terms - mine) | put)
