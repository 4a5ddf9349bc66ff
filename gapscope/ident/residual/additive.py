"""Fit of the additive form: per joint a sum of fixed functions, its parts sized by the evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gapscope.effects.residual.basis import draw_basis, part_of_each
from gapscope.effects.residual.network import ADDITIVE, LOG_VARIANCE, Network
from gapscope.ident.residual.evidence import Equations, Prior, most_evident, weights
from gapscope.ident.residual.folds import Folds

SHARES = (1.0, 0.2, 0.03)
"""Shares of the rows tried as independent; the one that predicts held-out rows best is kept."""
FIRST_SIZE, FIRST_NOISE = -3.0, -0.5
"""Logarithms of the first variances of a part and of the noise, over that of the target."""


def fit_additive(
    windows: np.ndarray,
    residual: np.ndarray,
    target: np.ndarray,
    folds: Folds,
    seed: int,
    progress: Callable[[str], None] = lambda message: None,
) -> Network:
    """Fit an ensemble; each member is fitted without the rows that it holds out.

    Args:
        windows: normalised, (n, M, taps, C).
        residual: over its scale [1], (M, n).
        target: the residual without its part in the physics, (M, n).
        folds: rows and targets of each member.
        seed: of the random waves.
        progress: called with a few words at each joint.
    """
    now = windows[:, :, -1]
    basis = draw_basis(now.min(axis=1), now.max(axis=1), seed)
    part = part_of_each(basis)
    functions = basis.features(now)
    members, n = len(folds.held), len(now)
    weight = np.zeros((members, n, len(part), 2))
    bias = np.zeros((members, n, 2))
    for joint, x in enumerate(functions):
        progress(f"fits the additive form: joint {joint + 1} of {n}")
        centre, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
        scaled = np.column_stack([(x - centre) / spread, np.ones(len(x))])
        found, noise = _fit_joint(
            scaled,
            residual[:, joint],
            target[:, joint],
            folds.of_joint(joint),
            # the constant is a part of its own
            np.append(part, part.max() + 1),
        )
        # the head sees the functions as they are
        by_function = found[:, :-1] / spread
        weight[:, joint, :, 0] = by_function
        bias[:, joint, 0] = found[:, -1] - by_function @ centre
        bias[:, joint, 1] = np.clip(np.log(noise), *LOG_VARIANCE)
    return Network(ADDITIVE, np.zeros(0, int), (weight,), (bias,), basis)


def _fit_joint(
    x: np.ndarray,
    residual: np.ndarray,
    target: np.ndarray,
    folds: Folds,
    part: np.ndarray,
) -> tuple[np.ndarray, float]:
    """Weights of each member, (members, F), and their mean square error on what they held out."""
    size = max(float(np.sqrt((target**2).mean())), 1e-12)
    whole = _equations(x, target / size, folds.weight, folds.any_fitted)
    each = [
        _equations(x, y / size, folds.weight, fitted)
        for y, fitted in zip(folds.targets[..., 0], folds.fitted, strict=True)
    ]
    parts = int(part.max()) + 1
    prior = Prior(part, np.full(parts, FIRST_SIZE), FIRST_NOISE, SHARES[0])
    least, kept = np.inf, np.zeros((len(each), x.shape[1]))
    for share in SHARES:
        prior = most_evident(whole, replace(prior, share=share))
        found = size * np.stack([weights(equations, prior) for equations in each])
        error = folds.error(residual, found @ x.T, folds.weight)
        if error < least:
            least, kept = error, found
    return kept, folds.error(residual, kept @ x.T, np.ones(len(x)))


def _equations(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, rows: np.ndarray
) -> Equations:
    """Normal equations of some rows, each times its weight."""
    wx = weight[rows, None] * x[rows]
    wy = weight[rows] * y[rows]
    return Equations(wx.T @ wx, wx.T @ wy, float(wy @ wy), float(len(wy)))
