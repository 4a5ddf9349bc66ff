"""The window of time in which a constant force from outside explains most of the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.diagnosis.model.scan import NonlinearParameters
from gapscope.diagnosis.thresholds import (
    FORCE_WINDOW_BIN,
    FORCE_WINDOW_RIDGE,
    LEAST_FORCE_WINDOW,
)


def force_window(
    t: np.ndarray,
    residual: np.ndarray,
    force: np.ndarray,
    weight: np.ndarray,
    bases: Sequence[np.ndarray],
) -> NonlinearParameters | None:
    """Start and end of the window [s]; ``None`` if recordings are too short for one.

    All pairs of edges between bins of ``FORCE_WINDOW_BIN`` are compared. What a window needs, sums over its rows, is
    the difference of two cumulative sums over the bins, so that a window costs the same however long it is.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        residual: residual of all joints [N m], (M, n).
        force: columns of a unit force on the same rows, (M, n, 3).
        weight: of the joints [1/(N m)^2], (n,).
        bases: per joint what was taken out of the residual, orthonormal columns, (M, K).
    """
    first = t.min()
    bins = int(np.ceil((t.max() - first) / FORCE_WINDOW_BIN))
    least = round(LEAST_FORCE_WINDOW / FORCE_WINDOW_BIN)
    if bins <= least:
        return None
    of_row = np.minimum(((t - first) / FORCE_WINDOW_BIN).astype(int), bins - 1)
    gram = np.einsum("mji,j,mjk->mik", force, weight, force)
    right = np.einsum("mji,j,mj->mi", force, weight, residual)
    grams, rights = _up_to_edge(gram, of_row, bins), _up_to_edge(right, of_row, bins)
    starts, ends = np.triu_indices(bins + 1, least)
    # F^T W F and F^T W r of each window, (windows, 3, 3) and (windows, 3)
    inside = grams[ends] - grams[starts]
    pull = rights[ends] - rights[starts]
    # a short window may hardly determine some direction
    # nor need a force act on any joint at all, as on a wheel's axis
    # the basis of a short recording explains almost any force: what is left of it must not be amplified
    inside += FORCE_WINDOW_RIDGE * inside
    inside += max(1e-6 * np.trace(grams[-1]) / 3, 1e-30) * np.eye(3)
    for j, basis in enumerate(bases):
        # what the basis can explain of the force in the window does not count: less (B^T F)^T (B^T F)
        products = basis[:, :, None] * force[:, j, None, :]
        within = _up_to_edge(products, of_row, bins)
        taken = within[ends] - within[starts]
        inside -= weight[j] * taken.transpose(0, 2, 1) @ taken
    best_force = np.linalg.solve(inside, pull[:, :, None])[:, :, 0]
    gains = np.einsum("wi,wi->w", pull, best_force)
    best = int(np.argmax(gains))
    start = float(first + FORCE_WINDOW_BIN * starts[best])
    end = float(first + FORCE_WINDOW_BIN * ends[best])
    return NonlinearParameters(
        (start, end), (FORCE_WINDOW_BIN / 2, FORCE_WINDOW_BIN / 2)
    )


def _up_to_edge(of_rows: np.ndarray, place: np.ndarray, bins: int) -> np.ndarray:
    """Sums of (M, ...) over all rows before each edge of the bins, (bins + 1, ...): zero before the first."""
    sums = np.zeros((bins + 1, *of_rows.shape[1:]))
    np.add.at(sums, place + 1, of_rows)
    return sums.cumsum(axis=0)
