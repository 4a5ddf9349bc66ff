"""Ridge regression with prediction of held-out folds, from sums of normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.thresholds import RIDGE_STRENGTHS


@dataclass(frozen=True)
class Folds:
    """How rows are left out together.

    Attributes:
        fold: of each row, (M,).
        fitted: rows that may be fitted, (M,); all are predicted.
    """

    fold: np.ndarray
    fitted: np.ndarray


def predict_held_out(x: np.ndarray, y: np.ndarray, folds: Folds) -> np.ndarray:
    """Prediction of y, (M,), each fold with a ridge regression on columns x, (M, p), of the other folds.

    The strength for a fold is the one that predicts the other folds best, those being left out in turn. If even the
    best is worse than predicting 0 there, the prediction is 0.
    """
    rows_of_fold = [folds.fold == fold for fold in np.unique(folds.fold)]
    by_strength = _predictions(x, y, folds.fitted, rows_of_fold)

    # Squared errors per strength and fold, and those of predicting 0.
    squares = (y - by_strength) ** 2
    errors = np.column_stack([squares[:, rows].sum(axis=1) for rows in rows_of_fold])
    powers = np.array([(y[rows] ** 2).sum() for rows in rows_of_fold])

    out = np.zeros(len(y))
    for k, rows in enumerate(rows_of_fold):
        # A fold has no say in its own strength: it is chosen by how the others are predicted.
        on_others = errors.sum(axis=1) - errors[:, k]
        best = int(np.argmin(on_others))
        if on_others[best] < powers.sum() - powers[k]:
            out[rows] = by_strength[best, rows]
    return out


def _predictions(
    x: np.ndarray, y: np.ndarray, fitted: np.ndarray, rows_of_fold: list[np.ndarray]
) -> np.ndarray:
    """Prediction of each fold from the others under each strength of the ridge, (strengths, M)."""
    # Normal equations of each fold: those of all others are sums less its own.
    grams, rights = [], []
    for rows in rows_of_fold:
        own = rows & fitted
        columns = x[own]
        grams.append(columns.T @ columns)
        rights.append(columns.T @ y[own])
    gram = np.sum(grams, axis=0)
    right = np.sum(rights, axis=0)
    mean_square = np.trace(gram) / len(gram)

    out = np.zeros((len(RIDGE_STRENGTHS), len(y)))
    for rows, own_gram, own_right in zip(rows_of_fold, grams, rights, strict=True):
        # One decomposition serves all strengths: a ridge adds to every eigenvalue.
        value, vector = np.linalg.eigh(gram - own_gram)
        rotated = vector.T @ (right - own_right)

        for k, strength in enumerate(RIDGE_STRENGTHS):
            ridged = np.maximum(value + strength * mean_square, 1e-300)
            coefficients = vector @ (rotated / ridged)
            out[k, rows] = x[rows] @ coefficients
    return out
