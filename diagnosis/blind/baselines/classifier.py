"""A classifier of effects from features of the gap: softmax regression, trained on separate generated cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from diagnosis.blind.baselines.columns import EFFECTS, Design
from diagnosis.blind.baselines.methods import answer, left_by

PENALTY = 1e-2
"""Weight of the squared coefficients."""


def features(design: Design) -> np.ndarray:
    """What each effect leaves of the gap, on the whole and on its best joint; size and concentration of the gap."""
    left = [left_by(design, effect) for effect in EFFECTS]
    nrmse = np.log(np.sort(design.nrmse)[::-1])
    spread = design.nrmse / design.nrmse.sum()
    along = np.abs(design.columns.T @ design.gap) / np.linalg.norm(design.gap)
    best = [max((float(along[k]) for k in design.places(effect)), default=0.0) for effect in EFFECTS]
    return np.concatenate([left, best, [nrmse[0], nrmse[1], nrmse[-1], -(spread * np.log(spread)).sum()]])


@dataclass(frozen=True)
class Classifier:
    """Softmax regression on standardised features.

    Attributes:
        classes: names of the C classes.
        middle, width: of the F features, (F,).
        weights: (F + 1, C), the last row the constants.
    """

    classes: tuple[str, ...]
    middle: np.ndarray
    width: np.ndarray
    weights: np.ndarray

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """Of each class, (N, C), from features (N, F)."""
        return _softmax(_constant((x - self.middle) / self.width) @ self.weights)

    def diagnose(self, design: Design) -> dict[str, Any]:
        """The likeliest class as a verdict."""
        p = self.probabilities(features(design)[None])[0]
        name = self.classes[int(p.argmax())]
        if name in ("healthy", "unknown"):
            return answer("no_gap" if name == "healthy" else "unexplained", [])
        return answer("effects_found", [(name, [])], float(p.max()))


def train(x: np.ndarray, names: Sequence[str]) -> Classifier:
    """Fit to features (N, F) and class names (N,) by penalised likelihood."""
    classes = tuple(sorted(set(names)))
    truth = np.array([[name == c for c in classes] for name in names], dtype=float)
    middle, width = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    a = _constant((x - middle) / width)

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        w = flat.reshape(a.shape[1], len(classes))
        p = _softmax(a @ w)
        value = -np.log(np.maximum((p * truth).sum(axis=1), 1e-300)).mean() + 0.5 * PENALTY * (w[:-1] ** 2).sum()
        slope = a.T @ (p - truth) / len(a)
        slope[:-1] += PENALTY * w[:-1]
        return float(value), slope.ravel()

    found = minimize(loss, np.zeros(a.shape[1] * len(classes)), jac=True, method="L-BFGS-B")
    return Classifier(classes, middle, width, found.x.reshape(a.shape[1], len(classes)))


def _constant(x: np.ndarray) -> np.ndarray:
    return np.hstack([x, np.ones((len(x), 1))])


def _softmax(z: np.ndarray) -> np.ndarray:
    e = np.exp(z - z.max(axis=1, keepdims=True))
    return e / e.sum(axis=1, keepdims=True)
