"""Rows as normal equations: named blocks in order, weights of rows, pieces that add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from gapscope.diagnosis.model.fit_data import (
    Discrepancy,
    EquationRows,
    Fold,
    discrepancy,
    inertial_errors,
)
from gapscope.diagnosis.model.normal_equations import (
    ErrorSizes,
    NormalEquations,
    data_sheet_prior,
    drawn,
    posteriors,
    solve,
)
from gapscope.diagnosis.thresholds import INERTIAL_ERROR, INERTIAL_ERRORS, SHAPE_ERROR


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


# Normal equations with nuisances, on numbers small enough to check by hand.


COLUMN = np.array([1.0, 0.0, 1.0])
NUISANCE = np.array([0.0, 1.0, 1.0])
GAP = np.array([2.0, 3.0, 5.0])
"""y = 2 A + 3 N exactly."""


def gram(*columns: np.ndarray) -> np.ndarray:
    x = np.column_stack(columns)
    return x.T @ x


def test_a_free_nuisance_takes_what_is_its_own() -> None:
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[1e-12]]))
    theta = normal.solve(np.array([0]))
    assert theta == pytest.approx([2.0], abs=1e-6)
    assert normal.nuisance(theta, np.array([0])) == pytest.approx([3.0], abs=1e-6)


def test_a_nuisance_with_a_narrow_prior_stays_zero() -> None:
    """A theta alone: theta = A y / A A = 7 / 2."""
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[1e12]]))
    theta = normal.solve(np.array([0]))
    assert theta == pytest.approx([3.5], abs=1e-6)
    assert normal.nuisance(theta, np.array([0])) == pytest.approx([0.0], abs=1e-6)


def test_a_prior_of_the_size_of_the_data_shrinks_a_nuisance() -> None:
    """Without the term delta = N y / (N N + Q) = 8 / (2 + 4)."""
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[4.0]]))
    none = np.array([], dtype=int)
    assert normal.solve(none) == pytest.approx([0.0])
    assert normal.nuisance(np.zeros(1), none) == pytest.approx([8 / 6])


def test_the_rest_is_measured_with_the_nuisance_or_without() -> None:
    total = gram(COLUMN, NUISANCE, GAP)
    normal, places = NormalEquations(total, 1, np.array([[1e-12]])), np.array([0])
    theta = normal.solve(places)
    rows = gram(COLUMN, NUISANCE, GAP, np.zeros_like(GAP))[None]
    with_nuisance = normal.rest(rows, theta, places, corrected=True)
    without = normal.rest(rows, theta, places, corrected=False)
    assert with_nuisance == pytest.approx([0.0], abs=1e-6)
    assert without == pytest.approx([18.0], abs=1e-4)  # |3 N|^2


def test_a_column_of_rounding_gets_zero_and_the_others_their_values() -> None:
    """The centre of a load along parallel axes: what rounding leaves of its column says nothing of any value."""
    rounding = 1e-8 * np.array([1.0, -2.0, 1.5])
    total = gram(COLUMN, rounding, NUISANCE, GAP)
    normal = NormalEquations(total, 2, np.array([[1e-12]]))
    assert normal.solve(np.array([0, 1])) == pytest.approx([2.0, 0.0], abs=1e-6)


def test_a_value_below_its_bound_stays_there_and_the_other_is_fitted_again() -> None:
    """|x + y - 1|^2 + |y - 3|^2 with x >= -1: by hand x = -2, y = 3 without the bound; with x = -1, y = 2.5."""
    columns = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 3.0]])
    least = columns.T @ columns
    places = np.array([0, 1])
    np.testing.assert_allclose(solve(least, places), [-2.0, 3.0], rtol=1e-6)
    bounds = np.array([-1.0, -np.inf])
    np.testing.assert_allclose(solve(least, places, bounds), [-1.0, 2.5], rtol=1e-6)


def test_nuisances_of_very_different_size_are_eliminated() -> None:
    """Columns 10^9 apart in size: their normal equations are singular to rounding unless they are scaled."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 4)) * np.array([1.0, 1e9, 1e-9, 1.0])
    normal = NormalEquations(x.T @ x, 1, np.diag([1e-12, 1e-12]))
    theta = normal.solve(np.array([0]))
    direct = np.linalg.lstsq(x[:, :2] / [1.0, 1e9], x[:, 3], rcond=None)[0]
    np.testing.assert_allclose(theta, direct[:1], rtol=1e-5)


# What a healthy arm leaves: nothing where a column explains the gap, a smooth rest where none does.


ROWS = 400
RNG = np.random.default_rng(3)
EXPLAINING = RNG.normal(size=(4, ROWS))
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
        for x, y in zip(EXPLAINING, gap, strict=True)
    ]


def learnt(gap: np.ndarray) -> Discrepancy:
    parts = halves(gap)
    folds = [Fold(half, 2) for half in parts]
    return discrepancy(folds, parts, np.array([gap.std()]), np.zeros(1))


def test_a_gap_that_a_term_explains_leaves_its_noise() -> None:
    found = learnt(2.0 * EXPLAINING + NOISE)
    assert np.sqrt(found.mean_square) == pytest.approx([0.1], rel=0.1)
    assert found.inflation == pytest.approx([1.0], abs=0.3)


def test_a_smooth_rest_is_the_discrepancy_and_has_few_samples() -> None:
    """A sine of 100 rows, amplitude 0.5: RMS 0.354; its rows are hardly independent."""
    smooth = 0.5 * np.sin(2 * np.pi * np.arange(ROWS) / 100)
    found = learnt(2.0 * EXPLAINING + smooth)
    assert np.sqrt(found.mean_square) == pytest.approx([0.354], rel=0.05)
    assert found.inflation[0] > 20


def test_a_model_of_few_terms_that_predicts_better_counts() -> None:
    """A term with another size on each fold: fitted to the others it predicts worse than none."""
    signs = np.array([3.0, -3.0, 3.0, -3.0])[:, None]
    found = learnt(signs * EXPLAINING)
    by_fold = (9 * EXPLAINING**2).mean(axis=1)
    assert found.mean_square == pytest.approx([np.median(by_fold)], rel=1e-6)


def test_what_happens_once_is_no_discrepancy() -> None:
    """A push during one of four folds."""
    push = np.zeros((4, ROWS))
    push[2, 100:300] = 5.0
    found = learnt(2.0 * EXPLAINING + NOISE + push)
    assert np.sqrt(found.mean_square) == pytest.approx([0.1], rel=0.5)


# Priors of the nuisances, on numbers to check by hand.


def test_a_level_widens_the_inertials_of_a_data_sheet_and_not_its_sensors() -> None:
    prior = data_sheet_prior(np.eye(2), 1)
    assert np.diag(prior.at(0.01)) == pytest.approx([1e4, 1e4, 1.0])


def test_sizes_scale_the_errors_of_the_inertials_together() -> None:
    errors = np.array([[1.0, 0.0], [0.5, 0.2]])
    sizes = data_sheet_prior(errors, 1).sizes
    for root, size in zip(sizes.roots, INERTIAL_ERRORS, strict=True):
        assert root[:2, :2] == pytest.approx(size * errors)
        assert root[2, 2] == 1.0
    # the usual size is the likeliest, and those that are not seen scatter about those that are
    likeliest = INERTIAL_ERRORS[np.argmax(sizes.log_prior)]
    assert likeliest == pytest.approx(INERTIAL_ERROR, rel=0.2)
    assert sizes.unseen.sum(axis=1) == pytest.approx(1.0)
    assert (np.diag(sizes.unseen) == sizes.unseen.max(axis=1)).all()


# Errors of bodies, against finite changes of pinocchio's inertias.


MASS = 2.0
CENTRE = np.array([0.1, -0.05, 0.2])
INERTIA = np.array([[0.03, 0.002, 0.0], [0.002, 0.02, -0.001], [0.0, -0.001, 0.01]])
DISTANCE = float(np.linalg.norm(CENTRE))


def parameters(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    return np.asarray(pin.Inertia(mass, centre, inertia).toDynamicParameters())


@pytest.fixture
def root() -> np.ndarray:
    """Columns of one body's errors in SI units, (10, 10)."""
    units = np.ones(10)
    # the distance of the centre is read from the unit of the first moments
    units[1:4] = MASS * DISTANCE
    own = inertial_errors(parameters(MASS, CENTRE, INERTIA), units)
    return np.asarray(own * units[:, None])


def test_a_wrong_mass_takes_all_moments_along(root: np.ndarray) -> None:
    grown = parameters(1.01 * MASS, CENTRE, 1.01 * INERTIA)
    expected = (grown - parameters(MASS, CENTRE, INERTIA)) / 0.01
    assert root[:, 0] == pytest.approx(expected)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_centre_that_is_off_moves_the_inertia_about_the_joint(
    root: np.ndarray, axis: int
) -> None:
    step = 1e-6 * np.eye(3)[axis]
    ahead, behind = (parameters(MASS, CENTRE + way, INERTIA) for way in (step, -step))
    expected = (ahead - behind) / 2e-6 * DISTANCE / np.sqrt(3.0)
    assert root[:, 1 + axis] == pytest.approx(expected, abs=1e-7)


def test_the_shape_of_the_inertia_is_off_by_less(root: np.ndarray) -> None:
    size = SHAPE_ERROR * 0.5 * np.trace(INERTIA)
    # in pinocchio's order xx, xy, yy, xz, yz, zz
    expected = size * np.array([1.0, 0.5, 1.0, 0.5, 0.5, 1.0])
    assert np.diag(root)[4:] == pytest.approx(expected)


def test_a_body_without_mass_has_no_error() -> None:
    both = np.concatenate([np.zeros(10), parameters(MASS, CENTRE, INERTIA)])
    units = np.concatenate([np.zeros(10), np.ones(10)])
    errors = inertial_errors(both, units)
    assert not errors[:10].any() and not errors[:, :10].any()
    assert errors[10:, 10:].any()


# Values beside errors of the nominal arm: intervals hold the truth whatever the size of the errors is.


SAMPLES, ERRORS = 60, 12
ONE = np.array([0])


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
        a, *others = rng.normal(size=(ERRORS, SAMPLES))
        n = np.column_stack([a, *others])
        errors = size * rng.normal(size=ERRORS)
        errors[0] *= unlike
        y = 5.0 * (a + n @ errors) + 0.5 * rng.normal(size=SAMPLES)
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
    a, b, n = rng.normal(size=(3, SAMPLES))
    sizes, both = one_size(0.01), np.array([0, 1])
    precision = np.array([0.0, 1.0])
    for true in (0.0, 2.0):
        y = a + true * b + 0.1 * rng.normal(size=SAMPLES)
        total = gram(np.column_stack([a, b]), n, y) / 0.01
        among = [posteriors(total, places, precision, sizes) for places in (both, ONE)]
        values = drawn(among, sizes.unseen, 2, rng, 400)
        assert (values[:, 1] != 0.0).mean() == pytest.approx(float(true > 0), abs=0.15)
        assert values[:, 0].mean() == pytest.approx(1.0, abs=0.05)
