"""What a healthy arm leaves: nothing where a column explains the gap, a smooth rest where none does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.diagnosis.model.discrepancy import Discrepancy, discrepancy
from gapscope.diagnosis.model.fold import EquationRows, Fold

ROWS = 400
RNG = np.random.default_rng(3)
COLUMN = RNG.normal(size=(4, ROWS))
NOISE = 0.1 * RNG.normal(size=(4, ROWS))


def halves(gap: np.ndarray) -> list[EquationRows]:
    """Four halves of one joint with one term, no inertials, from gaps of shape (4, ROWS)."""
    flat = np.zeros((ROWS, 1))
    empty = np.zeros((ROWS, 1, 0))
    rows = EquationRows(
        terms=empty,
        inertials=empty,
        others=empty,
        y=flat,
        rate=flat,
        sticking=flat,
        steady2=flat + 1e-4,
        known=flat + 1.0,
    )
    return [
        replace(rows, terms=x[:, None, None], y=y[:, None])
        for x, y in zip(COLUMN, gap, strict=True)
    ]


def learnt(gap: np.ndarray) -> Discrepancy:
    parts = halves(gap)
    folds = [Fold(half, 2) for half in parts]
    return discrepancy(folds, parts, np.array([gap.std()]), np.zeros(1))


def test_a_gap_that_a_term_explains_leaves_its_noise() -> None:
    found = learnt(2.0 * COLUMN + NOISE)
    assert np.sqrt(found.mean_square) == pytest.approx([0.1], rel=0.1)
    assert found.inflation == pytest.approx([1.0], abs=0.3)


def test_a_smooth_rest_is_the_discrepancy_and_has_few_samples() -> None:
    """A sine of 100 rows, amplitude 0.5: RMS 0.354; its rows are hardly independent."""
    smooth = 0.5 * np.sin(2 * np.pi * np.arange(ROWS) / 100)
    found = learnt(2.0 * COLUMN + smooth)
    assert np.sqrt(found.mean_square) == pytest.approx([0.354], rel=0.05)
    assert found.inflation[0] > 20


def test_a_model_of_few_terms_that_predicts_better_counts() -> None:
    """A term with another size on each fold: fitted to the others it predicts worse than none."""
    signs = np.array([3.0, -3.0, 3.0, -3.0])[:, None]
    found = learnt(signs * COLUMN)
    by_fold = (9 * COLUMN**2).mean(axis=1)
    assert found.mean_square == pytest.approx([np.median(by_fold)], rel=1e-6)


def test_what_happens_once_is_no_discrepancy() -> None:
    """A push during one of four folds."""
    push = np.zeros((4, ROWS))
    push[2, 100:300] = 5.0
    found = learnt(2.0 * COLUMN + NOISE + push)
    assert np.sqrt(found.mean_square) == pytest.approx([0.1], rel=0.5)
