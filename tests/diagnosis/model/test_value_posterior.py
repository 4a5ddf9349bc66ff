"""Values beside errors of the nominal arm: intervals hold the truth whatever the size of the errors is."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.model.nuisance_prior import ErrorSizes, data_sheet_prior
from gapscope.diagnosis.model.value_posterior import drawn, posteriors

ROWS, ERRORS = 60, 12
ONE = np.array([0])


def gram(a: np.ndarray, n: np.ndarray, y: np.ndarray) -> np.ndarray:
    x = np.column_stack([a, n, y])
    return x.T @ x


def one_size(size: float) -> ErrorSizes:
    return ErrorSizes((np.array([[size]]),), np.zeros(1), np.eye(1))


@pytest.mark.parametrize("samples", [1.0, 1e6])
def test_a_nuisance_of_the_same_form_is_as_uncertain_as_the_value(
    samples: float,
) -> None:
    x = np.sqrt(samples) * np.array([1.0, 0.0])
    (found,) = posteriors(gram(x, x, 2.0 * x), ONE, np.zeros(1), one_size(0.06))
    assert found.mean == pytest.approx([2.0])
    expected = np.sqrt(0.06**2 + 1.0 / samples)
    assert np.linalg.norm(found.root) == pytest.approx(expected, rel=1e-3)


def test_a_nuisance_that_the_data_tell_apart_adds_nothing() -> None:
    a, n = 1e3 * np.eye(2)
    (found,) = posteriors(gram(a, n, 2.0 * a), ONE, np.zeros(1), one_size(0.06))
    assert np.linalg.norm(found.root) == pytest.approx(1e-3, rel=1e-6)


def test_evidence_is_the_likelihood_of_the_data() -> None:
    """Two sizes, one nuisance, no term: y ~ N(0, 1 + s^2 n n^T)."""
    rng = np.random.default_rng(0)
    n, y = rng.normal(size=(2, 5))
    sizes = ErrorSizes((np.array([[0.3]]), np.array([[2.0]])), np.zeros(2), np.eye(2))
    nothing = np.zeros((5, 1))
    found = posteriors(gram(nothing, n, y), ONE[:0], np.zeros(1), sizes)

    def log_likelihood(size: float) -> float:
        covariance = np.eye(5) + size**2 * np.outer(n, n)
        quadratic = y @ np.linalg.solve(covariance, y)
        return float(-0.5 * (np.linalg.slogdet(covariance)[1] + quadratic))

    expected = log_likelihood(2.0) - log_likelihood(0.3)
    assert found[1].log_evidence - found[0].log_evidence == pytest.approx(expected)


def covered(size: float, unlike: float, cases: int = 150) -> tuple[float, float]:
    """Share of intervals that hold the truth, and their median half width; one error hides behind the term.

    The hidden error is ``unlike`` times as large as those that the data show.
    """
    rng = np.random.default_rng(1)
    prior = data_sheet_prior(np.eye(ERRORS), 0)
    hits, halves = [], []
    for _ in range(cases):
        a, *others = rng.normal(size=(ERRORS, ROWS))
        n = np.column_stack([a, *others])
        errors = size * rng.normal(size=ERRORS)
        errors[0] *= unlike
        y = 5.0 * (a + n @ errors) + 0.5 * rng.normal(size=ROWS)
        # every row in units of its noise
        total = gram(a, 5.0 * n, y) / 0.25
        found = posteriors(total, ONE, np.zeros(1), prior.sizes)
        draws = drawn([found], prior.sizes.unseen, 1, rng, 400)[:, 0]
        low, high = np.quantile(draws, [0.025, 0.975])
        hits.append(low <= 5.0 <= high)
        halves.append(0.5 * (high - low))
    return float(np.mean(hits)), float(np.median(halves))


@pytest.mark.parametrize("size", [0.01, 0.03, 0.1])
def test_intervals_hold_the_truth_whatever_the_size_of_the_errors(size: float) -> None:
    share, half = covered(size, 1.0)
    assert share >= 0.9
    # and are no wider than a few of the errors that they allow for
    assert half < 5.0 * (3.5 * 1.96 * size + 0.05)


def test_they_hold_it_if_the_hidden_error_is_larger_than_those_seen() -> None:
    assert covered(0.03, 1.5)[0] >= 0.9


def test_they_widen_with_the_errors_that_the_data_show() -> None:
    assert covered(0.1, 1.0, 40)[1] > 2.0 * covered(0.01, 1.0, 40)[1]


def test_the_set_of_terms_that_suits_the_data_is_drawn_from() -> None:
    """A second term that is there is kept, one that is not is left out, though both have the same prior."""
    rng = np.random.default_rng(2)
    a, b, n = rng.normal(size=(3, ROWS))
    sizes, both = one_size(0.01), np.array([0, 1])
    precision = np.array([0.0, 1.0])
    for true in (0.0, 2.0):
        y = a + true * b + 0.1 * rng.normal(size=ROWS)
        total = gram(np.column_stack([a, b]), n, y) / 0.01
        among = [posteriors(total, places, precision, sizes) for places in (both, ONE)]
        values = drawn(among, sizes.unseen, 2, rng, 400)
        assert (values[:, 1] != 0.0).mean() == pytest.approx(float(true > 0), abs=0.15)
        assert values[:, 0].mean() == pytest.approx(1.0, abs=0.05)
