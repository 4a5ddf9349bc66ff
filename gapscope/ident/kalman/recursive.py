"""Recursive estimation of base parameters: a Kalman filter whose state is beta."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from filterpy.kalman import KalmanFilter

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.kalman.track import Track
from gapscope.ident.model.linear_problem import Problem

VAGUE = 10.0
"""Standard deviation of an unknown parameter: this many times the torque's RMS over that of its column [1]."""


@dataclass(frozen=True)
class Recursive:
    """Kalman filter with beta as a random walk: beta+ = beta + w, tau = W beta + v.

    Without drift and with unlimited memory its last estimate is that of weighted least squares. Samples should lie
    no closer than the torque's low-pass leaves them independent: about half a period of its cut-off.

    Attributes:
        noise: standard deviation of the torque's noise [N m], shape (n,).
        start: estimate before the first sample, shape (b,); zeros by default.
        covariance: of it, shape (b, b); vague by default.
        memory: time constant of exponential forgetting [s]: older samples count exp(-age / memory); ``None`` for ever.
        drift: by name, how far a parameter may wander in a second, in its unit per square root of s.

    Source: ljung1999.
    """

    noise: np.ndarray
    start: np.ndarray | None = None
    covariance: np.ndarray | None = None
    memory: float | None = None
    drift: Mapping[str, float] = field(default_factory=dict)

    def follow(self, problem: Problem, t: np.ndarray | None = None) -> Track:
        """The estimate after each sample.

        Args:
            problem: in the order of time.
            t: times [s], shape (N,); by default from 0 on without gaps.

        Raises:
            InputError: a parameter or a size that does not fit the problem.
        """
        count, b = len(problem.torque), problem.matrix.shape[2]
        if t is None:
            t = problem.interval * np.arange(count)
        t = np.asarray(t, dtype=float)
        walk, kalman = self._walk(problem), self._filter(problem)
        value, spread = np.empty((count, b)), np.empty((count, b, b))
        innovation = np.empty_like(problem.torque)
        # gaps between recordings let the parameters wander for longer
        steps = np.maximum(np.diff(t, prepend=t[0] - problem.interval), 1e-9)
        for k in range(count):
            if k:
                kalman.alpha = self._fading(steps[k])
                kalman.predict(Q=np.diag(walk**2 * steps[k]))
            W = problem.matrix[k]
            kalman.update(problem.torque[k], H=W)
            # L^-1 with S = L L^T gives innovations unit variance
            root = np.linalg.cholesky(kalman.S)
            innovation[k] = np.linalg.solve(root, kalman.y)
            value[k] = kalman.x
            spread[k] = 0.5 * (kalman.P + kalman.P.T)
        added = np.diff(t, append=t[-1])[:, None] * walk**2
        return Track(
            names=tuple(problem.names),
            t=t,
            value=value,
            covariance=spread,
            innovation=innovation,
            walk=added,
        )

    def _fading(self, step: float) -> float:
        """Factor by which the deviation of the estimate grows in a step [s]; 1 with unlimited memory."""
        if self.memory is None:
            return 1.0
        return float(np.exp(0.5 * step / self.memory))

    def estimate(self, problem: Problem) -> Estimate:
        """The estimate after the last sample."""
        track = self.follow(problem)
        residual = np.sqrt(np.mean(problem.residual(track.value[-1]) ** 2, axis=0))
        return Estimate(
            names=track.names,
            value=track.value[-1],
            covariance=track.covariance[-1],
            residual=residual,
        )

    def _filter(self, problem: Problem) -> KalmanFilter:
        b, n = problem.matrix.shape[2], problem.n_joints
        noise = np.asarray(self.noise, dtype=float)
        if noise.shape != (n,) or not (noise > 0).all():
            raise InputError(
                f"expected {n} numbers above 0, one per joint", where="noise"
            )
        start, covariance = self.start, self.covariance
        if start is None:
            start = np.zeros(b)
        if covariance is None:
            covariance = self._vague(problem)
        kalman = KalmanFilter(dim_x=b, dim_z=n)
        kalman.F = np.eye(b)
        kalman.R = np.diag(noise**2)
        kalman.x = np.array(start, dtype=float)
        kalman.P = np.array(covariance, dtype=float)
        if kalman.x.shape != (b,) or kalman.P.shape != (b, b):
            raise InputError(
                f"the problem has {b} parameters, the start {kalman.x.size}",
                where="start",
            )
        return kalman

    @staticmethod
    def _vague(problem: Problem) -> np.ndarray:
        columns = np.sqrt(np.mean(problem.matrix**2, axis=(0, 1)))
        size = np.sqrt(np.mean(problem.torque**2))
        return np.diag((VAGUE * size / np.maximum(columns, 1e-9 * columns.max())) ** 2)

    def _walk(self, problem: Problem) -> np.ndarray:
        """Random walk of each parameter per square root of a second, shape (b,)."""
        names = list(problem.names)
        unknown = [name for name in self.drift if name not in names]
        if unknown:
            raise InputError(
                f"{', '.join(unknown)} is no parameter of the problem",
                f"choose among {', '.join(names)}",
                where="drift",
            )
        walk = np.zeros(len(names))
        for name, size in self.drift.items():
            walk[names.index(name)] = size
        return walk
