"""All linear estimators over one table of problems: where each must recover the truth, and where it must beat OLS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from problems import (
    SOLVABLE,
    TRUTH,
    constant_trajectory,
    not_a_number,
    problem,
    rank_deficient,
    too_few,
    well_conditioned,
)
from scipy.signal import lfilter

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimator
from gapscope.ident.estimators.irls import HuberLeastSquares
from gapscope.ident.estimators.maximum_likelihood import MaximumLikelihood
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.partial_update import PartialUpdate
from gapscope.ident.estimators.ridge import Ridge
from gapscope.ident.estimators.total_least_squares import TotalLeastSquares
from gapscope.ident.estimators.truncated_svd import TruncatedSvd
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import unit_warnings

PRIOR = 1.1 * TRUTH
PLAIN = ("well conditioned", "correlated noise")


@dataclass(frozen=True)
class Claim:
    """What an estimator claims: problems it recovers, problems on which it has at most half of OLS's error."""

    estimator: Estimator
    recovers: tuple[str, ...] = PLAIN
    halves: tuple[str, ...] = ()
    needs_rank: bool = True


CLAIMS = {
    "ols": Claim(OrdinaryLeastSquares(), ("well conditioned",)),
    "wls": Claim(
        WeightedLeastSquares(),
        ("well conditioned", "noise per joint"),
        ("noise per joint",),
    ),
    "irls": Claim(
        HuberLeastSquares(),
        ("well conditioned", "outliers", "noise per joint"),
        ("outliers",),
    ),
    "ridge gcv": Claim(
        Ridge("gcv"), ("well conditioned",), ("ill conditioned",), False
    ),
    "ridge l-curve": Claim(
        Ridge("l_curve"), ("ill conditioned",), ("ill conditioned",), False
    ),
    "truncated svd": Claim(
        TruncatedSvd(100.0),
        ("well conditioned", "ill conditioned"),
        ("ill conditioned",),
        False,
    ),
    "truncated svd gcv": Claim(TruncatedSvd(), ("well conditioned",), (), False),
    "total least squares": Claim(
        TotalLeastSquares(np.ones(4), 1.0),
        ("well conditioned", "errors in variables"),
        ("errors in variables",),
    ),
    "maximum likelihood": Claim(
        MaximumLikelihood(),
        ("well conditioned", "correlated noise", "noise per joint"),
        ("correlated noise", "noise per joint"),
    ),
    "partial update": Claim(
        PartialUpdate(PRIOR),
        ("well conditioned", "noise per joint", "ill conditioned"),
        ("ill conditioned",),
        False,
    ),
}
EACH = pytest.mark.parametrize("claim", CLAIMS.values(), ids=CLAIMS)
RECOVERS = [(name, kind) for name, claim in CLAIMS.items() for kind in claim.recovers]
HALVES = [(name, kind) for name, claim in CLAIMS.items() for kind in claim.halves]


def errors(estimator: Estimator, kind: str, runs: int = 5) -> np.ndarray:
    """Largest error of a parameter in each of some draws of a problem."""
    draws = [SOLVABLE[kind].make(np.random.default_rng(seed)) for seed in range(runs)]
    return np.array(
        [np.abs(estimator.estimate(draw).value - TRUTH).max() for draw in draws]
    )


@pytest.mark.parametrize(("name", "kind"), RECOVERS)
def test_recovers(name: str, kind: str) -> None:
    assert errors(CLAIMS[name].estimator, kind).max() < SOLVABLE[kind].recovered


@pytest.mark.parametrize(("name", "kind"), HALVES)
def test_has_at_most_half_the_error_of_ordinary_least_squares(
    name: str, kind: str
) -> None:
    own, plain = (
        errors(e, kind, 20) for e in (CLAIMS[name].estimator, OrdinaryLeastSquares())
    )
    assert np.median(own) < 0.5 * np.median(plain)


@EACH
def test_states_names_a_covariance_and_what_is_left(claim: Claim) -> None:
    given = well_conditioned(np.random.default_rng(3))
    estimate = claim.estimator.estimate(given)
    assert tuple(estimate.names) == tuple(given.names)
    assert np.allclose(estimate.covariance, estimate.covariance.T, atol=1e-15)
    assert (np.linalg.eigvalsh(estimate.covariance) > 0).all()
    assert np.allclose(
        estimate.residual, np.sqrt((given.residual(estimate.value) ** 2).mean(axis=0))
    )


UNBIASED = [name for name in CLAIMS if name not in ("ridge l-curve",)]


@pytest.mark.parametrize("name", UNBIASED)
def test_stated_errors_are_those_seen_under_white_noise(name: str) -> None:
    """Over 60 draws the errors in units of the stated deviation have an RMS of 1, within what 240 values allow."""
    estimates = [
        (CLAIMS[name].estimator.estimate(well_conditioned(np.random.default_rng(seed))))
        for seed in range(60)
    ]
    scaled = np.array(
        [(estimate.value - TRUTH) / estimate.deviation for estimate in estimates]
    )
    assert 0.8 < np.sqrt((scaled**2).mean()) < 1.2


@EACH
def test_order_of_the_samples_does_not_matter(claim: Claim) -> None:
    given = well_conditioned(np.random.default_rng(0))
    order = np.random.default_rng(1).permutation(len(given.torque))
    shuffled = Problem(
        given.matrix[order],
        given.torque[order],
        given.names,
        np.zeros(len(order), int),
        0.02,
    )
    one = Problem(
        given.matrix, given.torque, given.names, np.zeros(len(order), int), 0.02
    )
    values = [claim.estimator.estimate(p).value for p in (one, shuffled)]
    assert np.allclose(
        *values, atol=2e-3 if isinstance(claim.estimator, PartialUpdate) else 1e-7
    )


def small_motion(rng: np.random.Generator, reach: float, noise: float) -> Problem:
    """Four recordings of three joints by +-reach, with errors that drift; the columns hardly differ if it is small."""
    t = 0.02 * np.arange(500)
    speeds = np.arange(1, 4) + 0.3 * np.arange(4)[:, None]
    phases = rng.uniform(0, 6, (4, 3))
    q = reach * np.sin(speeds[:, None] * t[:, None] + phases[:, None]).reshape(-1, 3)
    W = np.stack([np.cos(q), np.sin(q), np.cos(2 * q), q], axis=2)
    drift = lfilter([noise], [1, -0.98], rng.standard_normal(W.shape[:2]), axis=0)
    return problem(W, W @ TRUTH + drift)


@pytest.mark.parametrize(
    "make",
    [lambda prior: Ridge("motion", prior), lambda prior: TruncatedSvd(None, prior, "motion")],
    ids=["ridge", "truncated svd"],
)  # fmt: skip
def test_held_out_motions_choose_what_another_motion_bears(
    make: Callable[[np.ndarray], Estimator],
) -> None:
    """Of small motions least squares and cross-validation of rows are far worse than the prior; this is not."""
    prior = TRUTH * np.array([1.1, 0.8, 1.2, 0.9])
    large = small_motion(np.random.default_rng(9), 1.5, 0.0)

    def error(beta: np.ndarray) -> float:
        return float(np.sqrt((large.residual(beta) ** 2).mean()))

    draws = [small_motion(np.random.default_rng(s), 0.05, 0.02) for s in range(6)]
    own, rows = (
        [error(estimator.estimate(draw).value) for draw in draws]
        for estimator in (make(prior), Ridge("gcv", prior))
    )
    assert max(own) < 1.5 * error(prior) and np.median(own) < 0.7 * error(prior)
    assert max(rows) > 5 * error(prior)
    # what the samples determine is not pulled
    clear = well_conditioned(np.random.default_rng(0))
    assert np.abs(make(prior).estimate(clear).value - TRUTH).max() < 0.02


def test_as_many_directions_as_asked() -> None:
    given = well_conditioned(np.random.default_rng(0))
    estimate = TruncatedSvd(None, PRIOR, 0).estimate(given)
    np.testing.assert_array_equal(estimate.value, PRIOR)
    whole = TruncatedSvd(None, PRIOR, 4).estimate(given)
    plain = OrdinaryLeastSquares().estimate(given)
    np.testing.assert_allclose(whole.value, plain.value, atol=1e-9)


class TestByHand:
    def test_line_through_three_points(self) -> None:
        """tau = 1, 2, 4 at w = 1, 2, 3: beta = 17 / 14, residual 21 - 17^2 / 14 = 5 / 14, variance 5 / 28 / 14."""
        estimate = OrdinaryLeastSquares().estimate(
            column([1.0, 2.0, 3.0], [1.0, 2.0, 4.0])
        )
        assert estimate.value[0] == pytest.approx(17 / 14)
        assert estimate.covariance[0, 0] == pytest.approx(5 / 28 / 14)

    def test_ridge_of_strength_one_halves(self) -> None:
        """beta = w.tau / (w.w (1 + lambda)); with a prior of 1 the difference to it is halved."""
        given = column([1.0, 2.0], [3.0, 1.0])
        assert Ridge(1.0).estimate(given).value[0] == pytest.approx(0.5)
        assert Ridge(1.0, np.array([2.0])).estimate(given).value[0] == pytest.approx(
            1.5
        )

    def test_total_least_squares_of_a_line_is_its_principal_axis(self) -> None:
        """Points (2, 1), (1, 2), (-1, 1) and (1, -1): A^T A = [[7, 2], [2, 7]], principal axis (1, 1), slope 1."""
        w, tau = [2.0, 1.0, -1.0, 1.0], [1.0, 2.0, 1.0, -1.0]
        estimate = TotalLeastSquares(np.ones(1), 1.0).estimate(column(w, tau))
        assert estimate.value[0] == pytest.approx(1.0)
        assert OrdinaryLeastSquares().estimate(column(w, tau)).value[
            0
        ] == pytest.approx(2 / 7)

    def test_total_least_squares_without_errors_in_the_columns_but_one(self) -> None:
        """An exact column of ones takes the means out: the line through (0, 1), (1, 2), (2, 3) is tau = 1 + w."""
        W = np.array([[[1.0, 0.0]], [[1.0, 1.0]], [[1.0, 2.0]], [[1.0, 3.0]]])
        estimate = TotalLeastSquares(np.array([0.0, 1.0]), 1.0).estimate(
            problem(W, np.array([[1.0], [2], [3], [4]]))
        )
        assert np.allclose(estimate.value, [1.0, 1.0])

    def test_truncated_svd_keeps_the_direction_that_is_excited(self) -> None:
        """Of columns (1, 1) and (1, 1 + 1e-9) only the sum counts: both get half of it."""
        W = np.array([[[1.0, 1.0]], [[2.0, 2.0 + 1e-9]], [[1.0, 1.0]]])
        estimate = TruncatedSvd(100.0).estimate(
            problem(W, np.array([[2.0], [4.0], [2.0]]))
        )
        assert np.allclose(estimate.value, [1.0, 1.0], atol=1e-6)
        assert "1 of 2 directions" in estimate.warnings[0]

    def test_huber_mean_of_a_point_far_off(self) -> None:
        """Of 0, 1, ..., 10 and 1000 the Huber mean solves sum psi = 0: 5 + k s / 11, s the scale; far below 88."""
        tau = [*range(11), 1000.0]
        estimate = HuberLeastSquares().estimate(_varied(tau))
        scale = np.median(np.abs(np.array(tau) - estimate.value[0])) / 0.6745
        assert estimate.value[0] == pytest.approx(5 + 1.345 * scale / 11, rel=1e-4)

    def test_weights_are_the_inverse_variances(self) -> None:
        """Joints with 1 +- 1 and 3 +- 3: noise 1 and 3 about their means, so nearer to 1 than the plain mean 2."""
        W = np.ones((4, 2, 1))
        W[3] = 2.0
        tau = np.array([[0.0, 0.0], [2.0, 6.0], [0.0, 0.0], [4.0, 12.0]])
        found = WeightedLeastSquares(rounds=1).estimate(problem(W, tau))
        start = OrdinaryLeastSquares().estimate(problem(W, tau)).value[0]
        rest = tau - W[..., 0] * start
        weight = 1 / (rest**2).mean(axis=0)
        assert found.value[0] == pytest.approx(
            (weight * (W[..., 0] * tau).sum(0)).sum() / (weight * 7).sum()
        )


def column(w: list[float], tau: list[float]) -> Problem:
    """A problem of one joint and one parameter."""
    return problem(np.array(w)[:, None, None], np.array(tau)[:, None])


def _varied(tau: list[float]) -> Problem:
    """A mean as a problem: a column of ones, whose last row is infinitesimally another so that the arm moves."""
    W = np.ones((len(tau), 1, 1))
    W[-1] = 1 + 1e-6
    return problem(W, np.array(tau)[:, None])


class TestRefuses:
    @EACH
    def test_not_a_number(self, claim: Claim) -> None:
        with pytest.raises(
            InputError, match=r"sample 8, joint 2.*\(a\).*\(b\).*\(c\)"
        ) as caught:
            claim.estimator.estimate(not_a_number(np.random.default_rng(0)))
        assert caught.value.where == "torque"

    @EACH
    def test_constant_trajectory(self, claim: Claim) -> None:
        with pytest.raises(
            InputError, match=r"trajectory is constant.*\(a\).*\(b\).*\(c\)"
        ):
            claim.estimator.estimate(constant_trajectory(np.random.default_rng(0)))

    @pytest.mark.parametrize("claim", [c for c in CLAIMS.values() if c.needs_rank])
    def test_too_few_samples(self, claim: Claim) -> None:
        with pytest.raises(
            InputError,
            match=r"1 samples of 3 joints are 3 equations for 4 parameters.*\(a\).*\(b\)",
        ):
            claim.estimator.estimate(too_few(np.random.default_rng(0)))

    @pytest.mark.parametrize("claim", [c for c in CLAIMS.values() if c.needs_rank])
    def test_columns_that_depend(self, claim: Claim) -> None:
        with pytest.raises(InputError, match=r"do not determine p4\. Either \(a\)"):
            claim.estimator.estimate(rank_deficient(np.random.default_rng(0)))

    def test_maximum_likelihood_with_fewer_samples_than_joints(self) -> None:
        W = np.random.default_rng(0).standard_normal((3, 3, 2))
        with pytest.raises(InputError, match="noise of 3 joints"):
            MaximumLikelihood().estimate(problem(W, W @ np.ones(2)))


@pytest.mark.parametrize("claim", [c for c in CLAIMS.values() if not c.needs_rank])
def test_without_full_rank_the_torque_is_still_explained(claim: Claim) -> None:
    given = rank_deficient(np.random.default_rng(0))
    assert claim.estimator.estimate(given).residual.max() < 0.12


@pytest.mark.parametrize(("factor", "size"), [(1000.0, "large"), (0.01, "small")])
def test_torque_in_another_unit_is_suspected_against_the_nominal_arm(
    factor: float, size: str
) -> None:
    given = well_conditioned(np.random.default_rng(0))
    wrong = problem(given.matrix, factor * given.torque)
    assert f"suspiciously {size}" in unit_warnings(wrong, PRIOR)[0]
    assert unit_warnings(given, PRIOR) == ()
    assert any(
        f"suspiciously {size}" in text
        for text in PartialUpdate(PRIOR).estimate(wrong).warnings
    )
