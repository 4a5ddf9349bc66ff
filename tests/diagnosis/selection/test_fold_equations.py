"""Equations of folds at a skew, and mean squares of what is left of each fold, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.model.discrepancy import Discrepancy
from gapscope.diagnosis.model.fold import EquationRows, Fold
from gapscope.diagnosis.model.normal_equations import NormalEquations, with_skew
from gapscope.diagnosis.selection.fold_equations import FoldEquations, mean_squares

A, N = np.array([1.0, 2.0, 0.0, 1.0]), np.array([0.0, 1.0, 1.0, 0.0])
HEALTHY = Discrepancy(np.array([0.36]), np.array([2.0]))
Y, D = np.array([3.0, 5.0, 1.0, 2.0]), np.array([1.0, 0.0, 2.0, 1.0])


def gram(*columns: np.ndarray) -> np.ndarray:
    x = np.stack(columns, axis=1)
    return x.T @ x


def fold(y: np.ndarray) -> Fold:
    """Four rows of one joint with one term and one inertial, whose floor is 0.5 N m."""
    flat = np.zeros((4, 1))
    rows = EquationRows(
        terms=A[:, None, None],
        inertials=N[:, None, None],
        others=np.zeros((4, 1, 0)),
        y=y[:, None],
        rate=D[:, None],
        sticking=flat,
        steady2=flat + 0.25,
        known=flat + 1.0,
    )
    return Fold(rows, 2)


def test_a_skew_takes_its_share_of_the_rate_from_the_gap() -> None:
    np.testing.assert_allclose(
        with_skew(gram(A, N, Y, D), 0.25), gram(A, N, Y - 0.25 * D)
    )
    np.testing.assert_allclose(with_skew(gram(A, N, Y, D), 0.0), gram(A, N, Y))


def test_rows_are_summed_and_floors_squared() -> None:
    equations = FoldEquations([fold(Y), fold(2 * Y)], HEALTHY)
    np.testing.assert_allclose(equations.gram[0, 0], gram(A, N, Y, D))
    np.testing.assert_allclose(equations.gram[1, 0], gram(A, N, 2 * Y, D))
    assert equations.count.tolist() == [[4.0], [4.0]]
    assert equations.floor2.tolist() == [[0.25], [0.25]]


def test_rows_count_by_the_discrepancy_and_it_is_what_is_expected_to_be_left() -> None:
    """Two rows count as one sample; a mean square of 0.36 is left where noise explains 0.25."""
    equations = FoldEquations([fold(Y)], HEALTHY)
    assert equations.independent.tolist() == [[2.0]]
    assert equations.expected2.tolist() == [[0.36]]


def test_equations_at_a_skew_are_those_of_the_gap_without_it() -> None:
    equations = FoldEquations([fold(Y)], HEALTHY)
    once, twice = np.ones((1, 1)), np.full((1, 1), 2.0)
    expected = gram(A, N, Y - 0.25 * D)
    np.testing.assert_allclose(equations.weighed(once)[0], gram(A, N, Y))
    np.testing.assert_allclose(equations.at(0.25).weighed(once)[0], expected)
    np.testing.assert_allclose(equations.at(0.25).weighed(twice)[0], 2 * expected)


def test_many_sets_of_values_leave_what_each_leaves_alone() -> None:
    """With nuisances and a skew, on folds that are predicted from the other."""
    equations = FoldEquations([fold(Y), fold(2 * A + D)], HEALTHY).at(0.25)
    by_fold = equations.weighed(np.ones((2, 1)))
    normals = NormalEquations(by_fold[::-1], 1, np.array([[0.5]]))
    columns = np.array([0])
    alone = equations.mean_square(normals, columns, corrected=True)
    reduced = normals.reduced(equations.gram, equations.skew)
    values = normals.solve_each(np.array([[0], [0]]))
    together = mean_squares(reduced, values, equations.count)
    np.testing.assert_allclose(together, [alone, alone])


def test_a_fold_is_predicted_with_the_values_of_its_own_equations() -> None:
    """y = 2 A on one fold, 3 A on the other; each predicted with the other's value leaves |A|^2 = 6 over 4 rows."""
    equations = FoldEquations([fold(2 * A), fold(3 * A)], HEALTHY)
    by_fold = equations.weighed(np.ones((2, 1)))
    own = NormalEquations(by_fold, 1, np.array([[1e12]]))
    others = NormalEquations(by_fold[::-1], 1, np.array([[1e12]]))
    columns = np.array([0])
    exchanged = equations.mean_square(others, columns, corrected=False)
    kept = equations.mean_square(own, columns, corrected=False)
    assert exchanged[:, 0] == pytest.approx([1.5, 1.5], abs=1e-5)
    assert kept[:, 0] == pytest.approx([0.0, 0.0], abs=1e-5)
