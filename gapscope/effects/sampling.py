"""Random numbers from which severities are made."""

from __future__ import annotations

import numpy as np


def random_sign(rng: np.random.Generator, size: int | None = None) -> np.ndarray:
    """-1 or 1, one or ``size`` of them."""
    return np.asarray(rng.choice([-1.0, 1.0], size))


def log_uniform(
    rng: np.random.Generator, low: float, high: float, size: int
) -> np.ndarray:
    """Values whose logarithms are uniform between those of ``low`` and ``high``, shape (size,)."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))
