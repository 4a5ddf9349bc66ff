"""A classifier of effects from features of the gap: a network with one hidden layer, trained on separate cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from gapscope.blind_check.baselines.columns import EFFECTS, Design
from gapscope.blind_check.baselines.methods import answer, left_by

PENALTY = 1e-2
"""Weight of the squared coefficients."""
HIDDEN = 32
"""Hidden units."""


def features(design: Design) -> np.ndarray:
    """What each effect leaves of the gap, on the whole and on its best joint; size and concentration of the gap."""
    left = [left_by(design, effect) for effect in EFFECTS]
    nrmse = np.log(np.sort(design.nrmse)[::-1])
    spread = design.nrmse / design.nrmse.sum()
    along = np.abs(design.columns.T @ design.gap) / np.linalg.norm(design.gap)
    best = [
        max((float(along[k]) for k in design.places(effect)), default=0.0)
        for effect in EFFECTS
    ]
    return np.concatenate(
        [left, best, [nrmse[0], nrmse[1], nrmse[-1], -(spread * np.log(spread)).sum()]]
    )


@dataclass(frozen=True)
class Classifier:
    """Softmax of [tanh([z 1] A) 1] B, z the standardised features.

    Attributes:
        classes: names of the C classes.
        middle, width: of the F features, (F,).
        inner: A, (F + 1, HIDDEN), the last row the constants; outer: B, (HIDDEN + 1, C).
    """

    classes: tuple[str, ...]
    middle: np.ndarray
    width: np.ndarray
    inner: np.ndarray
    outer: np.ndarray

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """Of each class, (N, C), from features (N, F)."""
        hidden = np.tanh(_constant((x - self.middle) / self.width) @ self.inner)
        return _softmax(_constant(hidden) @ self.outer)

    def diagnose(self, design: Design) -> dict[str, Any]:
        """The likeliest class as a verdict."""
        p = self.probabilities(features(design)[None])[0]
        name = self.classes[int(p.argmax())]
        if name in ("healthy", "unknown"):
            return answer("no_gap" if name == "healthy" else "unexplained", [])
        return answer("effects_found", [(name, [])], float(p.max()))


def train(x: np.ndarray, names: Sequence[str]) -> Classifier:
    """Fit to features (N, F) and class names (N,) by penalised likelihood, from fixed random weights."""
    classes = tuple(sorted(set(names)))
    truth = np.array([[name == c for c in classes] for name in names], dtype=float)
    middle, width = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    z = _constant((x - middle) / width)
    shapes = (z.shape[1], HIDDEN), (HIDDEN + 1, len(classes))
    cut = shapes[0][0] * HIDDEN

    def split(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return flat[:cut].reshape(shapes[0]), flat[cut:].reshape(shapes[1])

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        inner, outer = split(flat)
        hidden = np.tanh(z @ inner)
        p = _softmax(_constant(hidden) @ outer)
        value = -np.log(np.maximum((p * truth).sum(axis=1), 1e-300)).mean()
        value += 0.5 * PENALTY * ((inner[:-1] ** 2).sum() + (outer[:-1] ** 2).sum())
        off = (p - truth) / len(z)
        slopes = (
            z.T @ ((off @ outer[:-1].T) * (1.0 - hidden**2)),
            _constant(hidden).T @ off,
        )
        for slope, weights in zip(slopes, (inner, outer), strict=True):
            slope[:-1] += PENALTY * weights[:-1]
        return float(value), np.concatenate([slope.ravel() for slope in slopes])

    start = np.random.default_rng(0).normal(
        size=cut + shapes[1][0] * shapes[1][1]
    ) / np.sqrt(shapes[0][0])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 500})
    return Classifier(classes, middle, width, *split(found.x))


def _constant(x: np.ndarray) -> np.ndarray:
    return np.hstack([x, np.ones((len(x), 1))])


def _softmax(z: np.ndarray) -> np.ndarray:
    e = np.exp(z - z.max(axis=1, keepdims=True))
    return e / e.sum(axis=1, keepdims=True)
