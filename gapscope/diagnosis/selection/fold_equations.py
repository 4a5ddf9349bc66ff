"""Normal equations of the folds at one skew of sampling, as the evidence reads them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from gapscope.diagnosis.model.discrepancy import Discrepancy
from gapscope.diagnosis.model.fold import Fold
from gapscope.diagnosis.model.normal_equations import NormalEquations, with_skew


class FoldEquations:
    """Normal equations of F folds with m rows each, at one skew of sampling.

    Attributes:
        skew: the skew [s].
        gram: X^T W X of X = [A, N, y, d], (F, m, P + K + 2, P + K + 2), the same at any skew.
        count: weight of the rows, (F, m).
        floor2: mean square of a healthy arm [N^2 m^2], (F, m).
        independent: effective number of independent samples, (F, m).
        expected2: mean square that a model is expected to leave, the floor's or the discrepancy's [N^2 m^2], (F, m).
    """

    def __init__(
        self, folds: Sequence[Fold], healthy: Discrepancy, skew: float = 0.0
    ) -> None:
        self.skew = skew
        self.gram = np.array([fold.total for fold in folds])
        self.count = np.array([fold.count for fold in folds])
        self.floor2 = np.array([fold.floor for fold in folds]) ** 2
        joints = self.floor2.shape[1]
        self.independent = self.count / healthy.inflation[:joints]
        self.expected2 = np.maximum(self.floor2, healthy.mean_square[:joints])
        self._weighed: dict[bytes, np.ndarray] = {}
        self._eliminated: dict[bytes, tuple[NormalEquations, NormalEquations]] = {}

    def at(self, skew: float) -> FoldEquations:
        """The same at another skew [s]."""
        other = copy(self)
        other.skew = skew
        return other

    def weighed(self, weights: np.ndarray) -> np.ndarray:
        """X^T W X of X = [A, N, y - skew d] of each fold, its rows weighed by (F, m): (F, P + K + 1, P + K + 1)."""
        return with_skew(self._weighed_at(weights), self.skew)

    def normals(
        self,
        weights: np.ndarray,
        size: int,
        prior: np.ndarray,
        bounds: np.ndarray | None = None,
    ) -> tuple[NormalEquations, NormalEquations]:
        """Normal equations of all folds, and of all but each, their rows weighed by (F, m).

        Args:
            weights: of the rows.
            size, prior, bounds: see ``NormalEquations``.
        """
        key = weights.tobytes() + prior.tobytes()
        if key not in self._eliminated:
            by_fold = self._weighed_at(weights)
            total = by_fold.sum(axis=0)
            # at every skew the nuisances are eliminated alike
            self._eliminated.clear()
            self._eliminated[key] = (
                NormalEquations(total, size, prior, bounds),
                NormalEquations(total - by_fold, size, prior, bounds),
            )
        whole, without = self._eliminated[key]
        return whole.at(self.skew), without.at(self.skew)

    def _weighed_at(self, weights: np.ndarray) -> np.ndarray:
        """X^T W X of X = [A, N, y, d] of each fold; the same weights are asked for at every skew."""
        key = weights.tobytes()
        if key not in self._weighed:
            self._weighed.clear()
            pairs = zip(weights, self.gram, strict=True)
            sums = [np.tensordot(own, gram, axes=1) for own, gram in pairs]
            self._weighed[key] = np.array(sums)
        return self._weighed[key]

    def mean_square(
        self,
        normals: NormalEquations,
        columns: np.ndarray,
        *,
        corrected: bool,
    ) -> np.ndarray:
        """Mean square of the residual of each fold [N^2 m^2], (F, m).

        Args:
            normals: the equations that the values come from, of each fold its own or one for all.
            columns: places of the terms that are fitted.
            corrected: whether nuisances and skew are taken out of the residual.
        """
        theta = normals.solve(columns)
        skew = self.skew if corrected else 0.0
        squares = normals.rest(self.gram, theta, columns, skew, corrected=corrected)
        return squares / np.maximum(self.count, 1e-9)


def mean_squares(
    reduced: np.ndarray, theta: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """Mean square of the residual of each fold under S sets of values [N^2 m^2], (S, F, m).

    Args:
        reduced: of the folds' equations, see ``NormalEquations.reduced``, (F, m, P + 1, P + 1).
        theta: values for each fold, (F, S, P).
        count: weight of the rows, (F, m).
    """
    ones = np.ones((*theta.shape[:2], 1))
    # (F, 1, S, P + 1): the same values on all joints
    values = np.concatenate([theta, ones], axis=2)[:, None]
    squares = np.maximum(((values @ reduced) * values).sum(axis=-1), 0.0)
    return np.moveaxis(squares, 2, 0) / np.maximum(count, 1e-9)
