"""Discrepancy: how far a healthy arm differs from every model of it, learnt from the data itself.

All terms, the nominal inertials and the sensors' errors are fitted at once, under wide priors, to all folds but one,
and predict that one. What they leave is smooth and repeatable on a real arm, 4 to 23 % of the torque's deviation, and
about 1 % on a simulated one. No single effect can be expected to predict better than this, and no residual of this
size speaks for an effect; its autocorrelation says how many independent samples there are.

A model of few terms may predict a joint better than one of all: then its residual counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.model.fold import EquationRows, Fold
from gapscope.diagnosis.model.normal_equations import solve_positive
from gapscope.diagnosis.thresholds import (
    RICHEST_INERTIALS,
    RICHEST_ROUNDS,
    RICHEST_TERM,
)
from gapscope.model.effective_samples import group_slices, variance_inflation


@dataclass(frozen=True)
class Discrepancy:
    """What a healthy arm leaves of m rows: joints, or with joint torque sensors both sides of each.

    Attributes:
        mean_square: of the residual on a typical held-out fold, or on the reference [N^2 m^2], (m,).
        inflation: rows that count as one independent sample [1], (m,).
    """

    mean_square: np.ndarray
    inflation: np.ndarray


def discrepancy(
    folds: Sequence[Fold],
    halves: Sequence[EquationRows],
    deviation: np.ndarray,
    theta: np.ndarray,
) -> Discrepancy:
    """Discrepancy of the folds.

    Args:
        folds: normal equations of each half.
        halves: the rows that they were made of.
        deviation: of the torque, (m,) [N m].
        theta: parameters of the model so far, (P,).
    """
    gram = np.array([fold.total[:, :-1, :-1] for fold in folds])
    count = np.array([fold.count for fold in folds])
    precision = _precision(gram, count, deviation, halves[0])
    values = _held_out_values(gram, count, precision)

    so_far = np.zeros_like(values[0])
    so_far[: len(theta)] = theta
    residuals = [
        _weighted_residuals(halves, values),
        _weighted_residuals(halves, [so_far] * len(halves)),
    ]
    group = np.repeat(np.arange(len(halves)), [len(half.y) for half in halves])
    squares = np.array([_typical_square(r, group, count) for r in residuals])

    better = np.argmin(squares, axis=0)
    residual = np.where(better == 0, residuals[0], residuals[1])
    return Discrepancy(squares.min(axis=0), variance_inflation(residual, group))


def _typical_square(
    residual: np.ndarray, group: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """Median over the folds of the mean square, (m,): what happens once, such as a contact, is no discrepancy."""
    squares = [(residual[rows] ** 2).sum(axis=0) for rows in group_slices(group)]
    return np.asarray(np.median(squares / np.maximum(count, 1e-9), axis=0))


def _precision(
    gram: np.ndarray,
    count: np.ndarray,
    deviation: np.ndarray,
    rows: EquationRows,
) -> np.ndarray:
    """Prior precision of all columns, (P + K,).

    A term makes ``RICHEST_TERM`` times the torque's deviation on some joint; inertials are ``RICHEST_INERTIALS`` off,
    sensors as their data sheets say.
    """
    squares = (
        np.einsum("fjaa->ja", gram)[:, :-1]
        / np.maximum(count.sum(axis=0), 1e-9)[:, None]
    )
    size = (np.sqrt(squares) / deviation[:, None]).max(axis=0)
    terms, inertials = rows.terms.shape[2], rows.inertials.shape[2]
    spread = RICHEST_TERM / np.maximum(size, 1e-9)
    spread[terms : terms + inertials] = RICHEST_INERTIALS
    others = slice(terms + inertials, None)
    spread[others] = np.minimum(spread[others], 1.0)
    # columns that do nothing stay at zero
    return np.asarray(np.where(size > 1e-9, spread**-2.0, 1e18))


def _held_out_values(
    gram: np.ndarray, count: np.ndarray, precision: np.ndarray
) -> list[np.ndarray]:
    """Values of all columns fitted to all folds but each, (P + K,); joints are weighed by what is left on that fold."""
    total = np.maximum(count.sum(axis=0), 1e-9)
    mean_square = gram[..., -1, -1].sum(axis=0) / total
    for _ in range(RICHEST_ROUNDS):
        weight = 1.0 / np.maximum(mean_square, 1e-12)
        by_fold = np.array([np.tensordot(weight, own, axes=1) for own in gram])
        normal = by_fold.sum(axis=0)
        values = [_solved(normal - own, precision) for own in by_fold]
        z = [np.append(-value, 1.0) for value in values]
        squares = [own @ one @ one for own, one in zip(gram, z, strict=True)]
        mean_square = np.maximum(np.sum(squares, axis=0), 0.0) / total
    return values


def _solved(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Least squares under a prior from X^T W X of X = [columns, y]."""
    matrix = normal[:-1, :-1] + np.diag(precision)
    return solve_positive(matrix, normal[:-1, -1:])[:, 0]


def _weighted_residuals(
    halves: Sequence[EquationRows], values: Sequence[np.ndarray]
) -> np.ndarray:
    """Residual of each half under its values, weighed as in its normal equations [N m], (M, m)."""
    residuals = []
    for half, value in zip(halves, values, strict=True):
        terms, inertials = half.terms.shape[2], half.inertials.shape[2]
        parts = np.split(value, [terms, terms + inertials])
        residual = (
            half.y
            - half.terms @ parts[0]
            - half.inertials @ parts[1]
            - half.others @ parts[2]
        )
        residuals.append(residual * np.sqrt(half.weight))
    return np.vstack(residuals)
