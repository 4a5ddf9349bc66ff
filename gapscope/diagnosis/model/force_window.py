"""The window of time in which a constant force from outside explains most of the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.diagnosis.thresholds import (
    FORCE_WINDOW_BIN,
    FORCE_WINDOW_EDGES,
    FORCE_WINDOW_RIDGE,
    LEAST_FORCE_WINDOW,
)
from gapscope.model.scan import NonlinearParameters


def force_window(
    t: np.ndarray,
    residual: np.ndarray,
    force: np.ndarray,
    weight: np.ndarray,
    bases: Sequence[np.ndarray],
) -> NonlinearParameters | None:
    """Start and end of the window [s]; ``None`` if recordings are too short for one.

    What a window needs, sums over its rows, is the difference of two cumulative sums over bins of
    ``FORCE_WINDOW_BIN``, so that a window costs the same however long it is. All pairs of every so many edges are
    compared, ``FORCE_WINDOW_EDGES`` at most, and then all pairs of edges near the best one's. Bins without a row,
    between the parts of a recording with gaps, do not count.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        residual: residual of all joints [N m], (M, n).
        force: columns of a unit force on the same rows, (M, n, 3).
        weight: of the joints [1/(N m)^2], (n,).
        bases: per joint what was taken out of the residual, orthonormal columns, (M, K).
    """
    # stamps of most logs are whole multiples apart: no edge lies on one, where its rounding would decide
    first = t.min() - BEFORE_STAMPS
    last = max(int(np.ceil((t.max() - t.min()) / FORCE_WINDOW_BIN - 0.5)) - 1, 0)
    in_time = np.minimum(((t - first) / FORCE_WINDOW_BIN).astype(int), last)
    present, of_row = np.unique(in_time, return_inverse=True)
    bins, least = len(present), round(LEAST_FORCE_WINDOW / FORCE_WINDOW_BIN)
    if bins <= least:
        return None
    windows = _Windows(of_row, bins, residual, force, weight, bases)

    stride = -(-bins // FORCE_WINDOW_EDGES)
    coarse = np.append(np.arange(0, bins, stride), bins)
    start, end = windows.best(coarse, coarse, least)
    if stride > 1:
        near = np.arange(-stride, stride + 1)
        starts, ends = (np.clip(edge + near, 0, bins) for edge in (start, end))
        start, end = windows.best(np.unique(starts), np.unique(ends), least)
    # a window begins with its first bin, and ends with its last one
    edges = (present[start], present[end - 1] + 1)
    seconds = (float(first + FORCE_WINDOW_BIN * edge) for edge in edges)
    return NonlinearParameters(
        tuple(seconds), (FORCE_WINDOW_BIN / 2, FORCE_WINDOW_BIN / 2)
    )


BEFORE_STAMPS = 0.01 * FORCE_WINDOW_BIN
"""Time from an edge of the bins to the next stamp of a log with even stamps [s]."""


class _Windows:
    """Gains of a force in windows between edges of bins."""

    def __init__(
        self,
        of_row: np.ndarray,
        bins: int,
        residual: np.ndarray,
        force: np.ndarray,
        weight: np.ndarray,
        bases: Sequence[np.ndarray],
    ) -> None:
        """Sums up to each edge: F^T W F, (bins + 1, 3, 3), F^T W r, (bins + 1, 3), and B^T F of each joint."""
        weighted = force * weight[:, None]
        gram = np.einsum("mji,mjk->mik", weighted, force)
        right = np.einsum("mji,mj->mi", weighted, residual)
        self._grams = _up_to_edge(gram, of_row, bins)
        self._rights = _up_to_edge(right, of_row, bins)
        self._within = []
        for j, basis in enumerate(bases):
            product = basis[:, :, None] * force[:, j, None, :] * np.sqrt(weight[j])
            self._within.append(_up_to_edge(product, of_row, bins))

    def best(self, starts: np.ndarray, ends: np.ndarray, least: int) -> tuple[int, int]:
        """The edges between which a force explains most, of all pairs at least so many bins apart."""
        first, last = (x.ravel() for x in np.meshgrid(starts, ends))
        apart = last - first >= least
        first, last = first[apart], last[apart]
        pull = self._rights[last] - self._rights[first]
        force = np.linalg.solve(self._inside(first, last), pull[:, :, None])
        gains = np.einsum("wi,wi->w", pull, force[:, :, 0])
        k = int(np.argmax(gains))
        return int(first[k]), int(last[k])

    def _inside(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """F^T W F in each window, what the bases can explain of the force taken out, (windows, 3, 3)."""
        inside = self._grams[last] - self._grams[first]
        # a short window may hardly determine some direction
        # nor need a force act on any joint at all, as on a wheel's axis
        # the basis of a short recording explains almost any force: what is left of it must not be amplified
        inside += FORCE_WINDOW_RIDGE * inside
        inside += max(1e-6 * np.trace(self._grams[-1]) / 3, 1e-30) * np.eye(3)
        for within in self._within:
            # what the basis can explain of the force in the window does not count: less (B^T F)^T (B^T F)
            taken = within[last] - within[first]
            inside -= taken.transpose(0, 2, 1) @ taken
        return inside


def _up_to_edge(of_rows: np.ndarray, place: np.ndarray, bins: int) -> np.ndarray:
    """Sums of (M, ...) over all rows before each edge of the bins, (bins + 1, ...): zero before the first."""
    order = np.argsort(place, kind="stable")
    firsts = np.searchsorted(place[order], np.arange(bins))
    # every bin has a row
    sums = np.add.reduceat(of_rows[order], firsts, axis=0)
    return np.concatenate([np.zeros((1, *sums.shape[1:])), sums.cumsum(axis=0)])
