"""How well a trajectory excites: functions of the eigenvalues of the information matrix W^T W."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.nearest_name import check_known

FLOOR = 1e-13
"""Eigenvalues below this share of the largest count as this [1]."""


@dataclass(frozen=True)
class Criterion:
    """A function of the eigenvalues of A = S W^T W S, to be made small.

    Attributes:
        name: ``condition``, ``d`` or ``e``.
        scaling: ``unit``: S gives every column of W the norm 1; ``fixed``: S divides by the RMS that the column has
            over random states, and by the square root of the count of samples, so that larger motions count more.
        value: of the eigenvalues, shape (b,).
        slope: its derivative by each of them, shape (b,).
    """

    name: str
    scaling: str
    value: Callable[[np.ndarray], float]
    slope: Callable[[np.ndarray], np.ndarray]

    def evaluate(self, matrix: np.ndarray, reference: np.ndarray) -> float:
        """The value for W of shape (N, n, b), given the columns' RMS over random states, (b,)."""
        return self.value(self._spectrum(*self._scaled(matrix, reference))[0])

    def gradient(self, matrix: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Derivative of the value by W, shape (N, n, b)."""
        scaled, scale = self._scaled(matrix, reference)
        values, vectors = self._spectrum(scaled, scale)
        by_gram = (vectors * self.slope(values)) @ vectors.T
        by_scaled = 2 * scaled @ by_gram
        if self.scaling == "unit":
            # the norm of a column is divided out: no gradient along the column
            along = (scaled * by_scaled).sum(axis=0)
            by_scaled = by_scaled - scaled * along
        return (by_scaled / scale).reshape(matrix.shape)

    def _scaled(
        self, matrix: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        flat = matrix.reshape(-1, matrix.shape[2])
        scale = np.sqrt(len(flat)) * reference
        if self.scaling == "unit":
            scale = np.linalg.norm(flat, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        return flat / scale, scale

    @staticmethod
    def _spectrum(
        scaled: np.ndarray, scale: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = np.linalg.eigh(scaled.T @ scaled)
        return np.maximum(values, FLOOR * max(values[-1], FLOOR)), vectors


def condition_number(matrix: np.ndarray) -> float:
    """Condition number of W, shape (N, n, b), with every column scaled to unit norm [1]; infinite for a zero column."""
    flat = matrix.reshape(-1, matrix.shape[2])
    norms = np.linalg.norm(flat, axis=0)
    if (norms == 0).any():
        return float("inf")
    return float(np.linalg.cond(flat / norms))


def _log_condition(values: np.ndarray) -> float:
    return 0.5 * float(np.log(values[-1] / values[0]))


def _log_condition_slope(values: np.ndarray) -> np.ndarray:
    out = np.zeros_like(values)
    out[0], out[-1] = -0.5 / values[0], 0.5 / values[-1]
    return out


def _least_slope(values: np.ndarray) -> np.ndarray:
    out = np.zeros_like(values)
    out[0] = -0.5 / values[0]
    return out


CRITERIA = {
    "condition": Criterion(
        name="condition",
        scaling="unit",
        value=_log_condition,
        slope=_log_condition_slope,
    ),
    "d": Criterion(
        name="d",
        scaling="fixed",
        value=lambda v: -0.5 * float(np.mean(np.log(v))),
        slope=lambda v: -0.5 / (len(v) * v),
    ),
    "e": Criterion(
        name="e",
        scaling="fixed",
        value=lambda v: -0.5 * float(np.log(v[0])),
        slope=_least_slope,
    ),
}
"""``condition``: log of the condition number, columns scaled to unit norm [gautier1992]. ``d``: minus the mean log of
the singular values, half the log determinant over b; ``e``: minus the log of the smallest singular value
[swevers2007]."""


def criterion(name: str) -> Criterion:
    """A criterion by its name; raises ``InputError`` if there is none."""
    return CRITERIA[check_known("criterion", name, CRITERIA, where="criterion")]
