"""Draws of the values of a set of terms, from which their intervals follow.

Values are drawn beside errors of the nominal arm, of the sensors or of a reference whose size the data tell
(``gapscope/diagnosis/model/value_posterior.py``), with the weights of the evidence: independent samples over the square
of what a healthy arm leaves. Beside a data sheet, the gain by which each joint's torque is recorded is off as well,
unless its scale is among the terms. A changed link is an error of the nominal arm too: if one was named, the values of
all other terms are drawn with it and without it, as likely as the data make either.

Added to each draw is

- what values fitted without one half of a recording after the other scatter beyond it, by Student's t of the number of
  halves [kunsch1989];
- what the form of the model, wrong by ``MODEL_FORM``, may shift a value by, were half of it proportional to the term's
  own column;
- for laws whose form in nature differs, half of ``EFFECT_FORM`` of the value.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.model.value_posterior import Posterior, drawn, posteriors
from gapscope.diagnosis.selection.evidence import Evidence, columns_of
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    GAIN_ERROR,
    LINK_CHANGE,
    MODEL_FORM,
    VALUE_DRAWS,
)
from gapscope.effects.effect import External, Inertial, Sensing
from gapscope.model.terms import Term

EXACT = (Inertial, External, Sensing)
"""Kinds of effects whose form is that of mechanics."""


def value_draws(
    evidence: Evidence,
    terms: frozenset[Term],
    rng: np.random.Generator,
    count: int = VALUE_DRAWS,
) -> np.ndarray:
    """Values of the terms as likely as the data make them, zeros elsewhere, (count, P)."""
    unseen, size = evidence.linear.data.prior.sizes.unseen, evidence.terms.size
    found = _posteriors(evidence, terms)
    values = drawn([found], unseen, size, rng, count)
    linked = frozenset(t for t in terms if t.definition.scope == "link")
    if linked:
        links = columns_of(linked)
        changes = values[:, links]
        either = [found, _posteriors(evidence, terms - linked)]
        values = drawn(either, unseen, size, rng, count)
        values[:, links] = changes
    columns = columns_of(terms)
    values[:, columns] += _scatter(evidence, terms, values[:, columns], rng)
    values += rng.normal(size=values.shape) * _form_of_model(evidence)
    values *= _forms_of_effects(terms, rng, values.shape)
    out = np.zeros_like(values)
    # gains were drawn beside the terms
    out[:, columns] = np.maximum(values, evidence.bounds)[:, columns]
    return out


def _posteriors(evidence: Evidence, terms: frozenset[Term]) -> list[Posterior]:
    """The values of a set of terms, and of gains, under every size that the errors of the nominal arm may have."""
    total = evidence.scored.weighed(evidence.weights).sum(axis=0)
    precision = _precision(evidence, terms)
    columns = np.union1d(columns_of(terms), np.flatnonzero(precision))
    return posteriors(total, columns, precision, evidence.linear.data.prior.sizes)


def _precision(evidence: Evidence, terms: frozenset[Term]) -> np.ndarray:
    """Prior precision of the coordinates, (P,): of changed links that of ``LINK_CHANGE``, of gains, others are flat."""
    out = np.zeros(evidence.terms.size)
    gains = [
        t
        for t in evidence.terms.all
        if "scale" in t.definition.quantities.values() and t not in terms
    ]
    out[columns_of(gains)] = GAIN_ERROR**-2.0
    units = evidence.linear.data.units.reshape(-1, 10)
    for term in terms:
        if term.definition.scope == "link":
            mass, moment = units[term.joint - 1, :2]
            sizes = LINK_CHANGE * np.array([mass, *[moment / mass] * 3])
            out[list(term.columns)] = sizes**-2.0
    return out


def _scatter(
    evidence: Evidence,
    terms: frozenset[Term],
    values: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """What values scatter between halves of recordings beyond what draws of them, (D, C), do: (D, C)."""
    pairs = evidence.left_out(terms)
    without_half = np.array([half for pair in pairs for half in pair])
    halves = len(without_half)
    # of the jackknife
    variance = (halves - 1) * without_half[:, columns_of(terms)].var(axis=0)
    excess = np.sqrt(np.maximum(variance - values.var(axis=0), 0.0))
    return np.asarray(rng.standard_t(halves - 1, size=values.shape) * excess)


def _form_of_model(evidence: Evidence) -> np.ndarray:
    """Standard deviation that the form of the model adds to each value, (P,)."""
    squares = np.diagonal(evidence.torque.gram, axis1=2, axis2=3)
    power = squares[:, :, : evidence.terms.size].sum(axis=0)
    column_rms = np.sqrt(power / evidence.rows.sum(axis=0)[:, None])
    torque = evidence.linear.data.torque_deviation[:, None]
    by_joint = 0.5 * MODEL_FORM * torque / np.maximum(column_rms, 1e-12)
    return np.asarray(by_joint.min(axis=0))


def _forms_of_effects(
    terms: frozenset[Term], rng: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Factors on the values by which the forms of their laws differ from those in nature, (D, P)."""
    out = np.ones(shape)
    # in a fixed order, so that the same case has the same intervals
    for term in sorted(terms, key=lambda t: t.columns):
        if not isinstance(term.definition, EXACT):
            error = 0.5 * EFFECT_FORM * rng.normal(size=(shape[0], 1))
            out[:, list(term.columns)] += error
    return out
