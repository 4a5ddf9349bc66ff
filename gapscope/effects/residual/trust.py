"""Trust of a residual network: 1 near the inputs that it was trained on, 0 far from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Trust:
    """A factor between 0 and 1 from the distance to the nearest of L inputs seen in training, per joint.

    With r the radius and d the distance, u = clip((d - r) / r, 0, 1): trust is 1 - 3 u^2 + 2 u^3. It is 1 up to the
    radius, and exactly 0 from twice the radius on. Inputs are the normalised channels of the present sample.

    Attributes:
        landmarks: inputs seen, (n, L, C).
        radius: within which everything seen lies, (n,).
    """

    landmarks: np.ndarray
    radius: np.ndarray

    def distance(self, now: np.ndarray) -> np.ndarray:
        """Distance to the nearest landmark, (n, N), of inputs (n, N, C)."""
        return nearest(now, self.landmarks)

    def factor(self, now: np.ndarray) -> np.ndarray:
        """Trust, (n, N), of inputs (n, N, C)."""
        u = np.clip(self.distance(now) / self.radius[:, None] - 1.0, 0.0, 1.0)
        return np.asarray(1.0 - u * u * (3.0 - 2.0 * u))


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance from each point, (n, N, C), to the nearest of the others, (n, L, C); shape (n, N)."""
    cross = points @ others.transpose(0, 2, 1)
    square = (
        (points**2).sum(axis=2)[:, :, None]
        - 2.0 * cross
        + (others**2).sum(axis=2)[:, None]
    )
    return np.sqrt(np.clip(square.min(axis=2), 0.0, None))
