"""Numerical rank of a regressor: unit columns, and the gap in a spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from gapscope.arm.errors import InputError

EMPTY = 1e-12
"""A column whose norm is below this part of the largest has no content."""
DEPENDENT = 2e-5
"""Largest value of a spectrum, relative to a unit column, that can count as nil. Angles of a URDF rounded to four
decimals make directions of up to 5e-6, which no recording resolves."""
CLEAR_GAP = 1e3
"""Ratio of two neighbours in a spectrum from which the rank is certain."""
FLOOR = 1e-16
"""Values of a spectrum below this are rounding."""


def unit_triangle(Y: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Triangular factor of Y with its columns scaled to unit norm.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns, shape (p,).

    Returns:
        R of the scaled columns, zero in columns without content, shape (p, p); and the norms, 1 of those, shape (p,).

    Raises:
        InputError: values that are not finite, fewer rows than columns, or a regressor of zeros.
    """
    rows = np.asarray(Y, dtype=float).reshape(-1, len(names))
    if len(rows) < len(names):
        raise InputError(
            f"{len(rows)} rows do not determine {len(names)} parameters",
            "record more samples",
            where="regressor",
        )
    if not np.isfinite(rows).all():
        raise InputError(
            "the regressor has values that are not finite",
            "check the motion for missing values",
            where="regressor",
        )
    triangle = (
        rows
        if len(rows) == len(names)
        else qr(rows, mode="r", check_finite=False)[0][: len(names)]
    )
    norms = np.linalg.norm(triangle, axis=0)
    full = norms > EMPTY * norms.max()
    if not full.any():
        raise InputError(
            "the regressor is zero: nothing moves and nothing weighs", "record a motion"
        )
    norms = np.where(full, norms, 1.0)
    return np.where(full, triangle, 0.0) / norms, norms


def orthonormal_columns(x: np.ndarray, tolerance: float) -> np.ndarray:
    """Orthonormal basis of the columns of x, (M, K), scaled to one each; shape (M, r).

    Directions smaller than ``tolerance`` times the largest are left out. So are columns without content: what a body
    leaves on a joint on which it does not act is rounding, and scaled to one it would be a direction of its own.
    """
    norms = np.linalg.norm(x, axis=0)
    full = norms > EMPTY * norms.max()
    u, size, _ = np.linalg.svd(x[:, full] / norms[full], full_matrices=False)
    return np.asarray(u[:, size > tolerance * size[0]])


def rank_by_gap(spectrum: np.ndarray, tolerance: float = DEPENDENT) -> int:
    """Number of values that are not nil, of a falling spectrum that starts near 1.

    It ends at the first drop by ``CLEAR_GAP`` to a value below ``tolerance``, or, if there is none so clear, at the
    widest drop to a value below it. All count if no value is so small.
    """
    small = np.flatnonzero(spectrum <= tolerance)
    if not len(small):
        return len(spectrum)
    # below the floor a ratio is one of rounding errors
    values = np.maximum(spectrum, FLOOR)
    drops = values[small - 1] / values[small]
    clear = np.flatnonzero(drops >= CLEAR_GAP)
    end = clear[0] if len(clear) else np.argmax(drops)
    return int(small[end])


def gap_at(spectrum: np.ndarray, rank: int) -> float:
    """Ratio of the last value that counts to the first that does not; infinite if all count."""
    return (
        float("inf")
        if len(spectrum) <= rank
        else float(spectrum[rank - 1] / max(spectrum[rank], FLOOR))
    )
