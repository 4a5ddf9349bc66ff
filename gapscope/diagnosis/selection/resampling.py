"""Pieces of the data divided in two: what one half says of the values, and the other of them."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.model.normal_equations import with_skew
from gapscope.diagnosis.selection.evidence import Evidence


def alternate_pieces(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Weighted normal equations of every other piece of the data, and of those between."""
    pieces = _pieces(evidence)
    return pieces[::2].sum(axis=0), pieces[1::2].sum(axis=0)


def _pieces(evidence: Evidence) -> np.ndarray:
    """Weighted normal equations of every piece of the data, (pieces, C, C)."""
    # the last column is that of the skew, which is taken out of y
    columns = np.arange(evidence.scored.gram.shape[-1])
    out = []
    for fold, weights in zip(evidence.linear.folds, evidence.weights, strict=True):
        gram = with_skew(fold.scored.by_piece(columns), evidence.skew)
        out.append(np.einsum("bjxy,j->bxy", gram, weights))
    return np.concatenate(out)
