"""One joint's residual, on which candidates of a nonlinear parameter are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NonlinearParameters:
    """Values of a term's nonlinear parameters.

    Attributes:
        values: of the parameters.
        std: their standard deviations, from the curvature of the gain.
    """

    values: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class Scan:
    """The residual of one joint's gap.

    Attributes:
        residual: what no column of the basis explains [N m], (M,).
        basis: orthonormal columns taken out of it, (M, K).
        trust: square root of the weight of each row, (M,).
        noise: variance of the residual, counted per independent sample [N^2 m^2].
    """

    residual: np.ndarray
    basis: np.ndarray
    trust: np.ndarray
    noise: float

    def weighted(self, columns: np.ndarray) -> np.ndarray:
        """Columns on the rows, (M, K), by the trust in the rows."""
        return self.trust[:, None] * columns

    def gains(
        self, columns: np.ndarray, per_candidate: int, known: np.ndarray | None = None
    ) -> np.ndarray:
        """Sum of squares explained by each candidate's columns, which lie side by side, (M, K per_candidate).

        ``known`` are the columns' products if they are known already, see ``products``.
        """
        # in the precision of the columns, which would be copied otherwise
        projected = self.basis.T.astype(columns.dtype) @ columns
        within = projected.reshape(self.basis.shape[1], -1, per_candidate)
        # X^T X outside the basis, without forming the columns outside it
        own = products(columns, per_candidate) if known is None else known
        gram = own - _gram(within)
        residual = self.residual.astype(columns.dtype)
        right = (residual @ columns).reshape(-1, per_candidate).astype(float)
        # a column within the basis explains nothing: the ridge keeps it from dividing by zero
        size2 = np.diagonal(own, axis1=1, axis2=2)
        ridge = 1e-4 * size2.max(axis=1) + 1e-12
        gram += ridge[:, None, None] * np.eye(per_candidate)
        coefficients = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
        return np.einsum("ki,ki->k", right, coefficients)

    def best(
        self,
        candidates: np.ndarray,
        columns: np.ndarray,
        per_candidate: int = 1,
        known: np.ndarray | None = None,
    ) -> NonlinearParameters:
        """The candidate, shape (K,), with the largest gain, refined by a parabola through its neighbours."""
        gains = self.gains(columns, per_candidate, known)
        k = int(np.argmax(gains))
        inside = 0 < k < len(candidates) - 1
        near = slice(k - 1, k + 2)
        # clipped candidates may coincide at a bound, where there is no parabola
        if not inside or not np.diff(candidates[near]).all():
            return _uncertain(candidates[k], candidates)
        offset, curvature = _parabola(candidates[near], gains[near])
        if curvature >= 0:
            return _uncertain(candidates[k], candidates[near])
        peak = candidates[k] + offset
        # the gain falls by the noise where the parameter is one standard deviation off
        std = np.sqrt(self.noise) / np.sqrt(-curvature)
        return NonlinearParameters((float(peak),), (float(std),))


def _parabola(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Where the parabola through three points has its peak, from the middle one, and its curvature y'' / 2.

    By divided differences about the middle point, which lose no digits however close together the points are. The
    peak is moved to the outer points if it lies beyond them; of a parabola without one it is the middle point.
    """
    left, right = x[1] - x[0], x[2] - x[1]
    slope_left, slope_right = (y[1] - y[0]) / left, (y[2] - y[1]) / right
    curvature = (slope_right - slope_left) / (left + right)
    if curvature >= 0:
        return 0.0, float(curvature)
    slope = (slope_left * right + slope_right * left) / (left + right)
    farthest = right if slope > 0 else left
    if abs(slope) >= -2 * curvature * farthest:
        return float(np.sign(slope) * farthest), float(curvature)
    return float(-slope / (2 * curvature)), float(curvature)


def products(columns: np.ndarray, per_candidate: int) -> np.ndarray:
    """X^T X of each candidate's columns, which lie side by side, (M, K per_candidate): (K, c, c)."""
    return _gram(columns.reshape(len(columns), -1, per_candidate))


def _gram(x: np.ndarray) -> np.ndarray:
    """X^T X of each candidate, (K, c, c), from (M, K, c)."""
    # products of whole columns take a third of the time of numpy.einsum
    columns = np.moveaxis(x, 2, 0)
    of_pairs = [[(a * b).sum(axis=0) for a in columns] for b in columns]
    return np.array(of_pairs).T


def _uncertain(value: float, among: np.ndarray) -> NonlinearParameters:
    """A candidate whose neighbours say nothing: uncertain by half the range that was tried."""
    return NonlinearParameters((float(value),), (float(np.ptp(among) / 2),))
