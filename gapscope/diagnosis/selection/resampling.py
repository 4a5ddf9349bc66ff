"""Pieces of the data drawn again or divided in two: how far fitted values depend on which data there happen to be."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.model.normal_equations import NormalEquations, with_skew
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.evidence import Evidence, columns_of
from gapscope.diagnosis.thresholds import BOOTSTRAP_DRAWS, MODEL_FORM


def bootstrap(
    evidence: Evidence,
    terms: frozenset[Term],
    rng: np.random.Generator,
    draws: int = BOOTSTRAP_DRAWS,
) -> np.ndarray:
    """Values of the terms on pieces of the data drawn with replacement, shape (draws, P): a block bootstrap.

    To each draw errors are added that pieces of the same data cannot show: what the nuisances, as large as their prior
    says, shift the values by; and what the form of the model, wrong by ``MODEL_FORM``, may shift a value by, were half
    of it proportional to the term's own column.
    """
    columns, size = columns_of(terms), evidence.terms.size
    last = evidence.scored.gram.shape[-1] - 2
    pieces = _pieces(evidence, np.concatenate([columns, np.arange(size, last + 1)]))
    values = np.zeros((draws, size))
    for draw in range(draws):
        drawn = rng.integers(len(pieces), size=len(pieces))
        counts = np.bincount(drawn, minlength=len(pieces)).astype(float)
        total = np.tensordot(counts, pieces, axes=1)
        normal = NormalEquations(total, len(columns), evidence.prior)
        values[draw, columns] = normal.solve(np.arange(len(columns)))
    whole = NormalEquations(pieces.sum(axis=0), len(columns), evidence.prior)
    root = whole.spread_by_nuisances(np.arange(len(columns)))
    values[:, columns] += rng.normal(size=(draws, root.shape[1])) @ root.T
    return values + rng.normal(size=values.shape) * _systematic(evidence)


def alternate_pieces(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Weighted normal equations of every other piece of the data, and of those between."""
    pieces = _pieces(evidence, np.arange(evidence.scored.gram.shape[-1] - 1))
    return pieces[::2].sum(axis=0), pieces[1::2].sum(axis=0)


def _pieces(evidence: Evidence, places: np.ndarray) -> np.ndarray:
    """Weighted normal equations of every piece of the data, over some of the columns, (pieces, C, C).

    The last of the columns is y; that of the skew is read beside it.
    """
    out = []
    with_rate = np.append(places, places[-1] + 1)
    for fold, weights in zip(evidence.linear.folds, evidence.weights, strict=True):
        gram = with_skew(fold.scored.by_piece(with_rate), evidence.skew)
        out.append(np.einsum("bjxy,j->bxy", gram, weights))
    return np.concatenate(out)


def _systematic(evidence: Evidence) -> np.ndarray:
    """Standard deviation that the form of the model adds to each value, (P,)."""
    squares = np.diagonal(evidence.torque.gram, axis1=2, axis2=3)
    power = squares[:, :, : evidence.terms.size].sum(axis=0)
    column_rms = np.sqrt(power / evidence.rows.sum(axis=0)[:, None])
    torque = evidence.linear.data.torque_deviation[:, None]
    by_joint = 0.5 * MODEL_FORM * torque / np.maximum(column_rms, 1e-12)
    return by_joint.min(axis=0)
