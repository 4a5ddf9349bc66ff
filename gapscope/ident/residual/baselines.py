"""What a residual network has to beat: gradient boosting, and a Gaussian process on a subset of the rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.ident.residual.rows import ResidualRows

SUBSET = 600
"""Rows that the Gaussian process is fitted to, per joint."""
Baseline = Callable[[np.ndarray], np.ndarray]
"""From normalised windows (n, M, taps, C) to torque [N m], (M, n)."""


def seen(rows: ResidualRows, windows: np.ndarray) -> np.ndarray:
    """What all baselines see, (n, M, I): all channels now, and the joint's dq and direction before."""
    past = windows[:, :, :-1, rows.inputs.layout.past]
    flat = past.reshape(*past.shape[:2], -1)
    return np.concatenate([flat, windows[:, :, -1]], axis=2)


def gradient_boosting(rows: ResidualRows, seed: int = 0) -> Baseline:
    """Boosted trees per joint, 150 trees of 15 leaves."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    models = [
        HistGradientBoostingRegressor(
            max_iter=150,
            learning_rate=0.08,
            max_leaf_nodes=15,
            l2_regularization=1.0,
            random_state=seed,
        ).fit(x, y)
        for x, y in zip(seen(rows, rows.windows), rows.target.T, strict=True)
    ]
    return lambda windows: _torque(models, rows, windows)


def gaussian_process(rows: ResidualRows, seed: int = 0) -> Baseline:
    """A Gaussian process per joint, squared exponential of one length and white noise, on ``SUBSET`` rows at random."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    pick = np.random.default_rng(seed).permutation(len(rows.target))[:SUBSET]
    models = []
    for x, y in zip(seen(rows, rows.windows), rows.target.T, strict=True):
        kernel = ConstantKernel(0.5) * RBF(4.0, (0.5, 50.0)) + WhiteKernel(
            0.5, (1e-4, 10.0)
        )
        models.append(
            GaussianProcessRegressor(kernel, n_restarts_optimizer=0).fit(
                x[pick], y[pick]
            )
        )
    return lambda windows: _torque(models, rows, windows)


def _torque(models: list, rows: ResidualRows, windows: np.ndarray) -> np.ndarray:
    inputs = seen(rows, windows)
    columns = [model.predict(x) for model, x in zip(models, inputs, strict=True)]
    return np.asarray(np.stack(columns, axis=1) * rows.scale)
