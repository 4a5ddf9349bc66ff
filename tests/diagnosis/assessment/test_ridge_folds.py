"""Ridge regression over folds: what holds on all folds is predicted, what holds on one alone is not."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.assessment.ridge_folds import Folds, predict_held_out

X = np.tile(np.linspace(-1.0, 1.0, 50), 3)[:, None]
FOLD = np.repeat([0, 1, 2], 50)
ALL = np.ones(150, dtype=bool)


def test_a_line_is_predicted_from_the_other_folds() -> None:
    y = 2.0 * X[:, 0]
    predicted = predict_held_out(X, y, Folds(FOLD, ALL))
    np.testing.assert_allclose(predicted, y, atol=2e-3)


def test_a_slope_that_differs_on_every_fold_is_not() -> None:
    """Slopes 1, -1 and 0: whatever two folds say, the third knows nothing of it."""
    y = X[:, 0] * np.array([1.0, -1.0, 0.0])[FOLD]
    assert not predict_held_out(X, y, Folds(FOLD, ALL)).any()


def test_rows_that_may_not_be_fitted_are_predicted_but_teach_nothing() -> None:
    wrong = np.arange(150) % 2 == 0
    y = np.where(wrong, 2.0 * X[:, 0] + 0.1, 2.0 * X[:, 0])
    fitted = predict_held_out(X, y, Folds(FOLD, ~wrong))
    np.testing.assert_allclose(fitted, 2.0 * X[:, 0], atol=2e-3)
