"""Ridge regression judged on folds that were left out, from sums of normal equations."""

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


def predict_unseen(x: np.ndarray, y: np.ndarray, folds: Folds) -> np.ndarray:
    """Prediction of y, (M,), each fold with a ridge regression on columns x, (M, p), of the other folds.

    The strength for a fold is the one that predicts the other folds best, those being left out in turn. Where even the
    best does worse than nothing there, the prediction is 0: it knows nothing.
    """
    places = [folds.fold == f for f in np.unique(folds.fold)]
    grams, rights = [], []
    for place in places:
        rows = place & folds.fitted
        grams.append(x[rows].T @ x[rows])
        rights.append(x[rows].T @ y[rows])
    gram, right = np.sum(grams, axis=0), np.sum(rights, axis=0)
    ridge = np.trace(gram) / len(gram) * np.eye(len(gram))
    said = np.zeros((len(RIDGE_STRENGTHS), len(y)))
    for place, own, own_right in zip(places, grams, rights, strict=True):
        value, vector = np.linalg.eigh(gram - own)
        turned = vector.T @ (right - own_right)
        for k, strength in enumerate(RIDGE_STRENGTHS):
            said[k, place] = x[place] @ (
                vector @ (turned / np.maximum(value + strength * ridge[0, 0], 1e-300))
            )
    errors = np.array([[((y - s)[p] ** 2).sum() for p in places] for s in said])
    nothing = np.array([(y[p] ** 2).sum() for p in places])
    out = np.zeros(len(y))
    for f, place in enumerate(places):
        others = errors.sum(axis=1) - errors[:, f]
        best = int(np.argmin(others))
        if others[best] < nothing.sum() - nothing[f]:
            out[place] = said[best, place]
    return out
