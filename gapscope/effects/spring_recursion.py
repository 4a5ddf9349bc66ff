"""The motion of links behind springs, step by step, as a triangular band of equations that is set up once."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs


class SpringRecursion:
    """Delta of e joints over S steps, for any driving torque.

        (m + d) x[i+1] + (k - 2 m) x[i] + (m - d) x[i-1] = torque[i]

    Joints with m = d = 0 follow k x[i] = torque[i]. Solved for x[i+1], each step is a row of blocks below a diagonal of
    ones.

    Args:
        m, d, k: mass over h^2, damping over 2 h, and stiffness, (S, e, e).

    Raises:
        numpy.linalg.LinAlgError: a step does not determine the next one.
    """

    def __init__(self, m: np.ndarray, d: np.ndarray, k: np.ndarray) -> None:
        self._moving = np.diagonal(m, axis1=1, axis2=2)[0] > 0
        moves = self._moving[:, None]
        lead = np.where(moves, (m + d)[1:-1], k[2:])
        now = np.where(moves, (k - 2 * m)[1:-1], 0.0)
        before = np.where(moves, (m - d)[1:-1], 0.0)
        self._inverse = _inverse(lead)
        self._at_rest = np.linalg.pinv(k[0], rcond=1e-9)
        self._band = _band(self._inverse @ now, self._inverse @ before)

    def follow(self, torque: np.ndarray) -> np.ndarray:
        """Delta (S, e) under a torque (S, e), from its static value."""
        right = np.where(self._moving, torque[1:-1], torque[2:])
        pushed = self._inverse @ right[:, :, None]
        start = self._at_rest @ torque[0]
        return self._solve(start[:, None], pushed)[:, :, 0]

    def changes(self, delta: np.ndarray, damping: np.ndarray, h: float) -> np.ndarray:
        """Derivatives of delta (S, e) by the stiffness of each joint, then by its damping, (S, e, 2 e).

        Args:
            delta: as ``follow`` gives it.
            damping: derivative of each joint's damping by its stiffness, (S, e).
            h: step [s].
        """
        # one more of k or d pushes its own joint back by delta or its rate, at the sample that the step is about
        rate = np.where(self._moving, (delta[2:] - delta[:-2]) / (2 * h), 0.0)
        about = np.where(self._moving, delta[1:-1], delta[2:])
        by_stiffness = about + damping[1:-1] * rate
        blocks = [-self._inverse * x[:, None, :] for x in (by_stiffness, rate)]
        start = np.hstack([-self._at_rest * delta[0], np.zeros_like(self._at_rest)])
        return self._solve(start, np.concatenate(blocks, axis=2))

    def _solve(self, start: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        """Delta for R right-hand sides, (S, e, R): its first two samples (e, R), and what pushes the others."""
        right = np.concatenate([start[None], start[None], pushed])
        flat = right.reshape(-1, right.shape[2])
        found, _ = dtbtrs(self._band, flat, uplo="L", diag="U")
        return np.asarray(found).reshape(right.shape)


def _inverse(blocks: np.ndarray) -> np.ndarray:
    """Inverse of blocks (S, e, e); of a single joint, of which many are tried, a division."""
    if blocks.shape[1] > 1:
        return np.linalg.inv(blocks)
    if not blocks.all():
        raise np.linalg.LinAlgError("no inertia, damping or stiffness")
    return np.asarray(1.0 / blocks)


def _band(now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Blocks (S - 2, e, e) by which a step depends on the last two, as LAPACK stores a lower band: (3 e, S e)."""
    steps, e = len(now), now.shape[1]
    # entry (i, j) of the equations lies in row i - j, column j of the band, which is kept column by column
    columns = np.zeros((steps + 2, e, 3 * e))
    for a in range(e):
        for b in range(e):
            columns[1:-1, b, e + a - b] = now[:, a, b]
            columns[:-2, b, 2 * e + a - b] = before[:, a, b]
    return columns.reshape(-1, 3 * e).T
