"""Total least squares: the regressor has errors too, since velocity and acceleration come from noisy positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import finished
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples


@dataclass(frozen=True)
class TotalLeastSquares:
    """Minimises |[dW D^-1, dtau / s]|_F^2 with (W + dW) beta = tau + dtau, by the least right singular vector.

    D and s are the standard deviations of the errors in the columns and in the torque. Columns without error are
    eliminated first (mixed least squares and total least squares). The answer is consistent if rows have
    independent errors of these relative sizes; with the default, equal relative error of every column, it is only as
    good as that assumption.

    Attributes:
        column_noise: standard deviation of the errors of each column, shape (b,), 0 if it is exact; by default in
            proportion to the column's RMS.
        torque_noise: standard deviation of the torque's error in the same scale [N m]; by default in proportion to
            the torque's RMS.

    Covariance s^2 (1 + |x|^2) (A^T A - M s^2 I)^-1 in scaled columns. Source: vanhuffel1991.
    """

    column_noise: np.ndarray | None = None
    torque_noise: float | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        check_samples(problem)
        matrix, torque = problem.stacked()
        columns, scale = self._scales(matrix, torque)
        # columns without error come first: only the rest may be corrected
        exact = columns == 0
        order = np.argsort(~exact, kind="stable")
        first = int(exact.sum())
        unit = np.where(exact, 1.0, columns)
        equations = np.column_stack([(matrix / unit)[:, order], torque / scale])
        triangle = np.asarray(np.linalg.qr(equations, mode="r"))
        _, values, right = np.linalg.svd(triangle[first:, first:])
        least = right[-1]
        # the solution divides by this component
        if abs(least[-1]) < 1e-8:
            raise InputError(
                "no total least squares solution: the direction with the least error does not involve the torque. "
                "Either (a) columns nearly depend on each other, (b) the errors of the columns are set too large, or "
                "(c) the torque does not follow from the motion",
                "use base parameters, give column_noise, or use ordinary least squares",
                where="matrix",
            )
        scaled = np.zeros(len(order))
        scaled[first:] = -least[:-1] / least[-1]
        if first:
            corrected = triangle[:first, first:-1] @ scaled[first:]
            known = triangle[:first, -1] - corrected
            scaled[:first] = np.linalg.solve(triangle[:first, :first], known)
        ordered = _covariance(triangle, values[-1], scaled, first, len(torque))
        # back to the order and the units of the problem
        beta, covariance = np.empty(len(order)), np.empty_like(ordered)
        beta[order] = scaled
        covariance[np.ix_(order, order)] = ordered
        per_unit = np.outer(unit, unit) / scale**2
        return finished(problem, beta * scale / unit, covariance / per_unit)

    def _scales(
        self, matrix: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, float]:
        rms = np.sqrt((matrix**2).mean(axis=0))
        columns = (
            rms
            if self.column_noise is None
            else np.asarray(self.column_noise, dtype=float)
        )
        if columns.shape != rms.shape or (columns < 0).any() or not columns.any():
            raise InputError(
                f"expected {len(rms)} standard deviations from 0 on, not all 0",
                where="column_noise",
            )
        return columns, float(
            np.sqrt((torque**2).mean())
        ) if self.torque_noise is None else float(self.torque_noise)


def _covariance(
    triangle: np.ndarray, least: float, scaled: np.ndarray, first: int, rows: int
) -> np.ndarray:
    """Covariance in scaled columns, those without error first; shape (b, b)."""
    gram = triangle[:, :-1].T @ triangle[:, :-1]
    noisy = np.arange(len(gram)) >= first
    variance = least**2 / max(rows - len(gram), 1)
    # the noise of the columns adds to their squares
    bias = least**2 * np.diag(noisy.astype(float)) * (1 - 1e-9)
    inverse = np.linalg.pinv(gram - bias, hermitian=True)
    return variance * (1 + scaled[noisy] @ scaled[noisy]) * inverse
