"""Streaming least squares: the triangular factor of a regressor of any length, in memory that does not grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import get_lapack_funcs, solve_triangular

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.ident.model.regressor import Regressor

ROWS = 2000
"""Rows that are factored at a time."""
_SINGULAR = 1e-10
_GEQRF, _GEQRF_LWORK = get_lapack_funcs(("geqrf", "geqrf_lwork"), dtype=np.float64)


class TriangularFactor:
    """R and Q^T tau of a regressor W and a torque tau that arrive in chunks of rows.

    [W, tau] = Q [[R, z], [0, rho]] with orthogonal Q, which is not kept: each chunk is stacked below the triangle of
    those before it and factored again (TSQR). R^T R = W^T W, but without the squared condition number of that product.
    p columns.

    Args:
        columns: number p of columns of W.

    Attributes:
        rows: number M of rows that were added.

    Source: demmel2012.
    """

    def __init__(self, columns: int) -> None:
        self.rows = 0
        self._columns = columns
        self._stack = np.zeros((columns + 1 + ROWS, columns + 1), order="F")
        self._work = int(_GEQRF_LWORK(*self._stack.shape)[0])

    @property
    def columns(self) -> int:
        """Number p of columns."""
        return self._columns

    @property
    def triangle(self) -> np.ndarray:
        """R, shape (p, p), upper triangular; its diagonal may have either sign."""
        return self._stack[: self._columns, : self._columns].copy()

    @property
    def projected(self) -> np.ndarray:
        """The leading p entries z of Q^T tau, shape (p,)."""
        return self._stack[: self._columns, self._columns].copy()

    @property
    def residual_norm(self) -> float:
        """Norm rho of tau - W beta for the best beta [N m]."""
        rest = self._stack[self._columns, self._columns]
        if self._full_rank:
            return float(abs(rest))
        # rows of R without content have taken up some of tau
        unexplained = self.projected - self.triangle @ self.solve()
        return float(np.hypot(rest, np.linalg.norm(unexplained)))

    def add(self, W: np.ndarray, tau: np.ndarray | None = None) -> None:
        """Add rows.

        Args:
            W: shape (M, p) or (N, n, p).
            tau: [N m], shape (M,) or (N, n); zeros if ``None``.

        Raises:
            InputError: values that are not finite, or shapes that do not match.
        """
        W = np.asarray(W)
        self._check(
            W.shape[-1] == self._columns,
            f"expected {self._columns} columns, got {W.shape[-1]}",
        )
        W = W.reshape(-1, self._columns)
        tau = np.zeros(len(W)) if tau is None else np.asarray(tau).ravel()
        self._check(
            len(tau) == len(W),
            f"{len(W)} rows of the regressor, but {len(tau)} torques",
        )
        # rows that turn out not to be finite must leave the factor as it was
        before = self._stack[: self._columns + 1].copy()
        # chunks of fixed size bound the memory, whatever the length of the recording
        for start in range(0, len(W), ROWS):
            part = slice(start, start + ROWS)
            self._absorb(W[part], tau[part])
        if not np.isfinite(self._stack[: self._columns + 1]).all():
            self._stack[: self._columns + 1] = before
            self._check(False, "values that are not finite")
        self.rows += len(W)

    def merge(
        self, other: TriangularFactor, columns: Sequence[int] | np.ndarray | None = None
    ) -> None:
        """Add all rows of another factor.

        Args:
            other: the other factor, such as one of another recording, joint or process.
            columns: which columns of this factor are the other's, if it has fewer; shape (other.columns,).
        """
        places = np.arange(self._columns) if columns is None else np.asarray(columns)
        self._check(
            len(places) == other.columns,
            f"expected {len(places)} columns, got {other.columns}",
        )
        top = other.columns + 1
        # the rows of the other triangle replace all its rows
        W = np.zeros((top, self._columns))
        W[:, places] = other._stack[:top, : other.columns]
        self._absorb(W, other._stack[:top, other.columns])
        self.rows += other.rows

    def scaled(self, factor: float) -> TriangularFactor:
        """The factor of (factor W, factor tau), for weights."""
        out = TriangularFactor(self._columns)
        out._stack[:] = factor * self._stack
        out.rows = self.rows
        return out

    def select(self, columns: Sequence[int] | np.ndarray) -> TriangularFactor:
        """The factor of some columns of W, in the order given, such as those of base parameters."""
        out = TriangularFactor(len(columns))
        out._absorb(
            self._stack[: self._columns + 1, columns],
            self._stack[: self._columns + 1, self._columns],
        )
        out.rows = self.rows
        return out

    def solve(self) -> np.ndarray:
        """Beta that minimises the norm of tau - W beta, shape (p,); the shortest if several do."""
        if self._full_rank:
            return solve_triangular(self.triangle, self.projected)
        return np.linalg.lstsq(self.triangle, self.projected, rcond=_SINGULAR)[0]

    def covariance(self) -> np.ndarray:
        """Covariance of ``solve`` for white noise, rho^2 / (M - p) (R^T R)^-1, shape (p, p); W of full rank."""
        self._check(
            self.rows > self._columns,
            f"{self.rows} rows do not determine {self._columns} parameters",
        )
        variance = self.residual_norm**2 / (self.rows - self._columns)
        inverse = solve_triangular(self.triangle, np.eye(self._columns))
        return variance * inverse @ inverse.T

    @property
    def _full_rank(self) -> bool:
        size = np.abs(np.diag(self._stack[: self._columns, : self._columns]))
        return bool(size.min() > _SINGULAR * size.max())

    def _absorb(self, W: np.ndarray, tau: np.ndarray) -> None:
        """Factor the triangle so far and some rows below it into a new triangle."""
        top = self._columns + 1
        stack = self._stack[: top + len(W)]
        # a part of the array is not contiguous in columns, which LAPACK needs
        if len(W) < ROWS:
            stack = np.asfortranarray(stack)
        stack[top:, : self._columns] = W
        stack[top:, self._columns] = tau
        factored = _GEQRF(stack, lwork=self._work, overwrite_a=True)[0]
        self._stack[:top] = np.triu(factored[:top])

    @staticmethod
    def _check(fine: bool, problem: str) -> None:
        if not fine:
            raise InputError(
                problem, "check the regressor and the torque", where="streamed rows"
            )


class JointFactors:
    """Triangular factors of each joint's rows, of which each involves only some columns; n joints, p columns.

    Rows of a joint do not depend on the links before it and of other joints' friction, which makes their factors small.
    Stacked with weights they give weighted least squares with one noise level per joint.

    Args:
        support: which columns each joint's rows involve, boolean, shape (n, p), as of ``Regressor.support``.
    """

    def __init__(self, support: np.ndarray) -> None:
        self.support = np.asarray(support, dtype=bool)
        self.places = [np.flatnonzero(row) for row in self.support]
        self.joints = [TriangularFactor(len(places)) for places in self.places]

    def add(self, Y: np.ndarray, tau: np.ndarray | None = None) -> None:
        """Add samples: Y of shape (N, n, p) and tau [N m] of shape (N, n)."""
        if tau is None:
            tau = np.zeros(Y.shape[:2])
        for i, factor in enumerate(self.joints):
            places = self.places[i]
            for start in range(0, len(Y), ROWS):
                rows = slice(start, start + ROWS)
                factor.add(Y[rows, i][:, places], tau[rows, i])

    def merge(self, other: JointFactors) -> None:
        """Add all samples of other factors with the same columns."""
        for mine, others in zip(self.joints, other.joints, strict=True):
            mine.merge(others)

    def stacked(
        self, weights: Sequence[float] | np.ndarray | None = None
    ) -> TriangularFactor:
        """The factor of all joints' rows, those of joint i times ``weights[i]`` [1/(N m) or 1], shape (n,)."""
        out = TriangularFactor(self.support.shape[1])
        for i, (factor, places) in enumerate(
            zip(self.joints, self.places, strict=True)
        ):
            out.merge(
                factor if weights is None else factor.scaled(float(weights[i])), places
            )
        return out


def factored(
    regressor: Regressor, motion: Motion, torque: np.ndarray | None = None
) -> JointFactors:
    """Factors of the regressor of a motion, which itself is never held: ``ROWS`` samples of it at a time.

    Args:
        regressor: of the arm.
        motion: N samples.
        torque: [N m], shape (N, n); zeros if ``None``, as base parameters do not need it.
    """
    factors, count = JointFactors(regressor.support), len(motion.t)
    # one array for all chunks
    room = np.empty((min(ROWS, count), *regressor.support.shape))
    for start in range(0, count, ROWS):
        rows = slice(start, min(start + ROWS, count))
        chunk = Motion(
            motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]
        )
        Y = regressor.matrix(chunk, room[: rows.stop - start])
        factors.add(Y, None if torque is None else torque[rows])
    return factors
