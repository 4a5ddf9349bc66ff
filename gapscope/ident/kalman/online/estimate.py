"""The state of a Kalman filter over parameters: an estimate with its covariance, and its three steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ParameterState:
    """Estimate of p parameters.

    Attributes:
        value: x, shape (p,).
        covariance: P, shape (p, p); a parameter that is known has zeros.
    """

    value: np.ndarray
    covariance: np.ndarray

    def assimilated(self, information: np.ndarray, score: np.ndarray) -> ParameterState:
        """The estimate with more equations r = W x + noise, as A = sum W^T W / sigma^2 and s = sum W^T r / sigma^2.

        P+ = (I + P A)^-1 P,   x+ = x + P+ (s - A x)

        This is the measurement update of all their samples at once, whatever their number; that of
        ``gapscope.ident.kalman.recursive`` needs one of the size of the samples each. Source: ljung1999.
        """
        P = self.covariance
        updated = np.linalg.solve(np.eye(len(P)) + P @ information, P)
        updated = 0.5 * (updated + updated.T)
        value = self.value + updated @ (score - information @ self.value)
        return ParameterState(value, updated)

    def wandered(self, walk: np.ndarray, duration: float) -> ParameterState:
        """After a time [s] in which parameters wander by ``walk`` per square root of a second, shape (p,)."""
        added = np.diag(walk**2 * duration)
        return ParameterState(self.value, self.covariance + added)

    def changed(
        self, directions: np.ndarray, size: np.ndarray, covariance: np.ndarray
    ) -> ParameterState:
        """After a change D delta, D of shape (p, s), whose size (s,) has a covariance (s, s)."""
        value = self.value + directions @ size
        added = directions @ covariance @ directions.T
        return ParameterState(value, self.covariance + added)
