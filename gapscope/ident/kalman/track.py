"""What a recursive filter saw: an estimate at every sample."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Track:
    """Estimates of b parameters after each of N samples of n channels.

    Attributes:
        names: of the parameters, shape (b,).
        t: time [s], shape (N,).
        value: shape (N, b).
        covariance: shape (N, b, b).
        innovation: measured minus predicted over its standard deviation, white with unit variance if the model
            holds [1], shape (N, n).
        walk: variance that the random walk adds between a sample and the next, shape (N, b).
    """

    names: tuple[str, ...]
    t: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray
    walk: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (N, b)."""
        return np.sqrt(np.einsum("kii->ki", self.covariance).clip(0.0))

    def of(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Value and standard error of one parameter, shape (N,) each."""
        place = self.names.index(name)
        return self.value[:, place], self.deviation[:, place]

    def smoothed(self) -> Track:
        """The track smoothed with later samples, by the Rauch-Tung-Striebel recursion; memory must be unlimited.

        With G = P (P + Q)^-1: x_s = x + G (x_s' - x), P_s = P + G (P_s' - P - Q) G^T, ' the next sample. Only the
        parameters that wander (Q > 0) lag; for the others G passes the last estimate on.
        """
        value, covariance = self.value.copy(), self.covariance.copy()
        for k in range(len(value) - 2, -1, -1):
            own = self.covariance[k]
            ahead = own + np.diag(self.walk[k])
            # parameters differ by orders of magnitude: solved with a unit diagonal
            scale = np.sqrt(np.diag(ahead).clip(1e-300))
            outer = np.outer(scale, scale)
            unit_gain = np.linalg.solve(ahead / outer, own / outer).T
            gain = scale[:, None] * unit_gain / scale
            value[k] = self.value[k] + gain @ (value[k + 1] - self.value[k])
            spread = own + gain @ (covariance[k + 1] - ahead) @ gain.T
            covariance[k] = 0.5 * (spread + spread.T)
        return replace(self, value=value, covariance=covariance)
