"""Root mean square: the size of errors, torques and columns."""

from __future__ import annotations

import numpy as np

SMALLEST = float(np.finfo(float).tiny)
"""The machine's smallest number: keeps quotients and logarithms of what may be nothing finite."""


def rms(x: np.ndarray, axis: int | tuple[int, ...] | None = 0) -> np.ndarray:
    """Root mean square of a series over time, or over other axes; ``None``: over all."""
    return np.asarray(np.sqrt(np.mean(x**2, axis=axis)))
