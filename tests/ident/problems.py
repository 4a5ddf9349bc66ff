"""The table of problems that drives the tests of all estimators: three joints, four parameters of size about one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.ident.samples import Problem

TRUTH = np.array([2.0, -1.0, 0.5, 3.0])
NAMES = ("p1", "p2", "p3", "p4")


def problem(
    matrix: np.ndarray, torque: np.ndarray, interval: float = 0.02, groups: int = 4
) -> Problem:
    """A problem whose samples fall into groups of equal length."""
    group = np.arange(len(torque)) * groups // max(len(torque), 1)
    return Problem(
        matrix,
        torque,
        tuple(f"p{i + 1}" for i in range(matrix.shape[2])),
        group,
        np.full(len(torque), interval),
    )


def matrix(rng: np.random.Generator, samples: int = 400) -> np.ndarray:
    return rng.standard_normal((samples, 3, len(TRUTH)))


def well_conditioned(rng: np.random.Generator) -> Problem:
    W = matrix(rng)
    return problem(W, W @ TRUTH + 0.1 * rng.standard_normal(W.shape[:2]))


def ill_conditioned(rng: np.random.Generator) -> Problem:
    """Columns 3 and 4 differ by a thousandth, and noise is large."""
    W = matrix(rng, 100)
    W[..., 3] = W[..., 2] + 1e-3 * W[..., 3]
    return problem(W, W @ TRUTH + 0.5 * rng.standard_normal(W.shape[:2]))


def outliers(rng: np.random.Generator) -> Problem:
    """One sample of twenty is off by 20, always to the same side."""
    clean = well_conditioned(rng)
    struck = rng.random(clean.torque.shape) < 0.05
    return problem(
        clean.matrix, clean.torque + 20.0 * struck * np.sign(clean.matrix[..., 0])
    )


def errors_in_variables(rng: np.random.Generator) -> Problem:
    """The columns are as noisy as the torque, relative to their sizes."""
    W = matrix(rng, 4000)
    torque = W @ TRUTH
    torque += 0.5 * torque.std() * rng.standard_normal(W.shape[:2])
    return problem(W + 0.5 * rng.standard_normal(W.shape), torque)


def noise_per_joint(rng: np.random.Generator) -> Problem:
    """Joint 3 is a hundred times as noisy as joint 1."""
    W = matrix(rng)
    return problem(
        W, W @ TRUTH + np.array([0.02, 0.2, 2.0]) * rng.standard_normal(W.shape[:2])
    )


def correlated_noise(rng: np.random.Generator) -> Problem:
    """All joints share one noise, but for a twentieth of it."""
    W = matrix(rng)
    shared, own = rng.standard_normal((len(W), 1)), rng.standard_normal(W.shape[:2])
    return problem(W, W @ TRUTH + shared + 0.05 * own)


def rank_deficient(rng: np.random.Generator) -> Problem:
    """Column 4 is twice column 3."""
    W = matrix(rng)
    W[..., 3] = 2 * W[..., 2]
    return problem(W, W @ TRUTH + 0.1 * rng.standard_normal(W.shape[:2]))


def too_few(rng: np.random.Generator) -> Problem:
    W = matrix(rng, 1)
    return problem(W, W @ TRUTH)


def constant_trajectory(rng: np.random.Generator) -> Problem:
    W = np.repeat(matrix(rng, 1), 200, axis=0)
    return problem(W, W @ TRUTH + 0.1 * rng.standard_normal(W.shape[:2]))


def not_a_number(rng: np.random.Generator) -> Problem:
    clean = well_conditioned(rng)
    torque = clean.torque.copy()
    torque[7, 1] = np.nan
    return problem(clean.matrix, torque)


@dataclass(frozen=True)
class Kind:
    """A problem, and the error that may be left where an estimator recovers it (largest of the parameters)."""

    make: Callable[[np.random.Generator], Problem]
    recovered: float


SOLVABLE = {
    "well conditioned": Kind(well_conditioned, 0.02),
    "ill conditioned": Kind(ill_conditioned, 2.0),
    "outliers": Kind(outliers, 0.02),
    "errors in variables": Kind(errors_in_variables, 0.2),
    "noise per joint": Kind(noise_per_joint, 0.01),
    "correlated noise": Kind(correlated_noise, 0.05),
}
