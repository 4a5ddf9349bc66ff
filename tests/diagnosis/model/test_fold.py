"""Rows as normal equations: named blocks in order, weights of rows, pieces that add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.diagnosis.model.fold import EquationRows, Fold


def equations(rows: int = 40) -> EquationRows:
    """One joint, two terms, one inertial, no sensor."""
    rng = np.random.default_rng(0)
    flat = np.zeros((rows, 1))
    return EquationRows(
        terms=rng.normal(size=(rows, 1, 2)),
        inertials=rng.normal(size=(rows, 1, 1)),
        others=np.zeros((rows, 1, 0)),
        y=rng.normal(size=(rows, 1)),
        rate=rng.normal(size=(rows, 1)),
        sticking=flat,
        steady2=flat + 0.25,
        known=flat + 1.0,
    )


def test_blocks_stand_in_the_order_terms_inertials_gap_rate() -> None:
    rows = equations()
    x = rows.of_joint(0)
    np.testing.assert_array_equal(x[:, :2], rows.terms[:, 0])
    np.testing.assert_array_equal(x[:, 2], rows.inertials[:, 0, 0])
    np.testing.assert_array_equal(x[:, 3], rows.y[:, 0])
    np.testing.assert_array_equal(x[:, 4], rows.rate[:, 0])


def test_pieces_add_up_to_the_whole() -> None:
    rows = equations()
    fold, x = Fold(rows, 4), rows.of_joint(0)
    pieces = fold.by_piece(np.array([0, 2, 4]))
    assert pieces.shape == (4, 1, 3, 3)
    np.testing.assert_allclose(fold.total[0], x.T @ x)
    np.testing.assert_allclose(
        pieces.sum(axis=0)[0], fold.total[0][np.ix_([0, 2, 4], [0, 2, 4])]
    )
    assert fold.count == pytest.approx([40])
    assert fold.floor == pytest.approx([0.5])


def test_rows_that_may_stick_count_less() -> None:
    """Sticking as large as the floor halves the weight."""
    rows = equations()
    fold = Fold(replace(rows, sticking=np.full((40, 1), 0.5)), 2)
    np.testing.assert_allclose(fold.total, 0.5 * Fold(rows, 2).total)
    assert fold.count == pytest.approx([20])


def test_rows_that_were_not_measured_do_not_count() -> None:
    rows = equations()
    known = np.ones((40, 1))
    known[20:] = 0.0
    fold = Fold(replace(rows, known=known), 2)
    assert fold.count == pytest.approx([20])
    assert not fold.by_piece(np.arange(5))[1].any()


def test_halves_are_the_first_and_the_second_half() -> None:
    rows = equations(9)
    first, second = rows.halves()
    assert len(first.y) == 4 and len(second.y) == 5
    np.testing.assert_array_equal(np.vstack([first.y, second.y]), rows.y)
