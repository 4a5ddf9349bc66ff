"""Removing and swapping terms of a model: while that raises the evidence, and if nobody could see the difference."""

from __future__ import annotations

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.moves import by_finding, by_term, neighbours
from gapscope.diagnosis.selection.visibility import closed_by
from gapscope.diagnosis.thresholds import (
    HOPELESS_LOSS,
    MOVE_GAIN,
    REFINE_GAIN,
    REFINE_STEPS,
    REFUSED_MOVES,
    VISIBLE_EFFECT,
    VISIBLE_TERM,
)
from gapscope.model.terms import Term


def refine(model: Model) -> Model:
    """Remove and swap terms while that raises the evidence, around their own values as well."""
    visited, refused = {model.fit.terms}, 0
    for _ in range(REFINE_STEPS):
        untried = [
            terms
            for terms in neighbours(model.fit.terms, model.terms)
            if terms not in visited
        ]
        fits = model.evidence.fits(untried)
        best = max(fits, key=lambda fit: fit.score, default=model.fit)
        if best.score < model.fit.score + REFINE_GAIN:
            break
        moved = fit_terms(model, best.terms, least_gain=-HOPELESS_LOSS)
        visited |= {best.terms, moved.fit.terms}
        # the linearisation that promised the gain is that of the model before
        if model.gain_of(moved) >= 0:
            model = moved
            continue
        refused += 1
        if refused == REFUSED_MOVES:
            break
    return model


def prune(model: Model) -> Model:
    """Take out, one by one, what no person could see: effects, then terms, whose loss hardly widens the gap.

    Compliant joints stay: a local linearisation cannot test their removal.
    """
    for least, parts in ((VISIBLE_EFFECT, by_finding), (VISIBLE_TERM, by_term)):
        while removable := _removable(model):
            loss = {
                part: closed_by(model, model.fit.terms - part, model.fit.terms)
                for part in parts(removable)
            }
            faintest = min(loss, key=lambda part: loss[part])
            if loss[faintest] >= least:
                break
            model = fit_terms(model, model.fit.terms - faintest)
    return model


def drop_unneeded(model: Model) -> Model:
    """Take out effects without which the evidence falls by less than a move has to raise it, one by one.

    Beside what was pruned an effect may have raised the evidence that it does not raise alone, and wider errors of the
    nominal inertials may do as well without it.
    """
    while parts := by_finding(_removable(model)):
        fits = model.best_of([model.fit.terms - part for part in parts])
        best = max(fits, key=lambda fit: fit.score)
        if best.score <= model.fit.score - MOVE_GAIN:
            return model
        without = fit_terms(model, best.terms)
        if model.gain_of(without) <= -MOVE_GAIN:
            return model
        model = without
    return model


def _removable(model: Model) -> frozenset[Term]:
    return frozenset(t for t in model.fit.terms if t.definition.locally_linear)
