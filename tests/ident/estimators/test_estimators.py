"""All linear estimators over one table of problems: where each must recover the truth, and where it must beat OLS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from arms import iiwa_of_three
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
from gapscope.arm.motions.motion import Motion
from gapscope.ident.estimators.by_name import METHODS, Given
from gapscope.ident.estimators.linear import (
    Estimate,
    Estimator,
    huber,
    maximum_likelihood,
    ordinary_least_squares,
    partial_update,
    ridge,
    total_least_squares,
    truncated_svd,
    weighted_least_squares,
)
from gapscope.ident.estimators.physical import (
    Bodies,
    log_cholesky,
    possible_arm,
    semidefinite,
)
from gapscope.ident.model.base_parameters import (
    BaseParameters,
    structural_base,
)
from gapscope.ident.model.physical_parameters import check_links
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import Problem, unit_warnings

PRIOR = 1.1 * TRUTH
PLAIN = ("well conditioned", "correlated noise")
PER_JOINT = ("well conditioned", "noise per joint")
ILL, NOISY = ("ill conditioned",), ("errors in variables",)


@dataclass(frozen=True)
class Claim:
    """What an estimator claims: problems it recovers, problems on which it has at most half of OLS's error."""

    estimator: Estimator
    recovers: tuple[str, ...] = PLAIN
    halves: tuple[str, ...] = ()
    needs_rank: bool = True


CLAIMS = {
    "ols": Claim(ordinary_least_squares, ("well conditioned",)),
    "wls": Claim(weighted_least_squares, PER_JOINT, PER_JOINT[1:]),
    "irls": Claim(huber, (*PER_JOINT, "outliers"), ("outliers",)),
    "ridge": Claim(partial(ridge, choice=1e-9), PER_JOINT[:1], (), False),
    "ridge l-curve": Claim(partial(ridge, choice="l_curve"), ILL, ILL, False),
    "truncated svd": Claim(truncated_svd, PER_JOINT[:1], (), False),
    "total least squares": Claim(total_least_squares, (PLAIN[0], *NOISY), NOISY),
    "maximum likelihood": Claim(
        maximum_likelihood,
        (*PLAIN, "noise per joint"),
        ("correlated noise", "noise per joint"),
    ),
    "partial update": Claim(
        partial(partial_update, prior=PRIOR), (*PER_JOINT, *ILL), ILL, False
    ),
}
EACH = pytest.mark.parametrize("claim", CLAIMS.values(), ids=CLAIMS)
RECOVERS = [(name, kind) for name, claim in CLAIMS.items() for kind in claim.recovers]
HALVES = [(name, kind) for name, claim in CLAIMS.items() for kind in claim.halves]


def errors(estimator: Estimator, kind: str, runs: int = 5) -> np.ndarray:
    """Largest error of a parameter in each of some draws of a problem."""
    draws = [SOLVABLE[kind].make(np.random.default_rng(seed)) for seed in range(runs)]
    return np.array([np.abs(estimator(draw).value - TRUTH).max() for draw in draws])


@pytest.mark.parametrize(("name", "kind"), RECOVERS)
def test_recovers(name: str, kind: str) -> None:
    assert errors(CLAIMS[name].estimator, kind).max() < SOLVABLE[kind].recovered


@pytest.mark.parametrize(("name", "kind"), HALVES)
def test_has_at_most_half_the_error_of_ordinary_least_squares(
    name: str, kind: str
) -> None:
    own, plain = (
        errors(e, kind, 20) for e in (CLAIMS[name].estimator, ordinary_least_squares)
    )
    assert np.median(own) < 0.5 * np.median(plain)


UNBIASED = [name for name in CLAIMS if name not in ("ridge l-curve",)]


@pytest.mark.parametrize("name", UNBIASED)
def test_stated_errors_are_those_seen_under_white_noise(name: str) -> None:
    """Over 60 draws the errors in units of the stated deviation have an RMS of 1, within what 240 values allow."""
    scaled = []
    for seed in range(60):
        found = CLAIMS[name].estimator(well_conditioned(np.random.default_rng(seed)))
        scaled.append((found.value - TRUTH) / found.deviation)
    assert 0.8 < np.sqrt(np.mean(np.square(scaled))) < 1.2


def small_motion(rng: np.random.Generator, reach: float, noise: float) -> Problem:
    """Four recordings of three joints by +-reach, with errors that drift; the columns hardly differ if it is small."""
    t = 0.02 * np.arange(500)
    speeds = np.arange(1, 4) + 0.3 * np.arange(4)[:, None]
    phases = rng.uniform(0, 6, (4, 3))
    q = reach * np.sin(speeds[:, None] * t[:, None] + phases[:, None]).reshape(-1, 3)
    W = np.stack([np.cos(q), np.sin(q), np.cos(2 * q), q], axis=2)
    drift = lfilter([noise], [1, -0.98], rng.standard_normal(W.shape[:2]), axis=0)
    return problem(W, W @ TRUTH + drift)


@pytest.mark.parametrize("make", [ridge, truncated_svd], ids=["ridge", "svd"])
def test_held_out_motions_choose_what_another_motion_bears(
    make: Callable[..., Estimate],
) -> None:
    """Of small motions least squares is far worse than the prior; this is not."""
    prior = TRUTH * np.array([1.1, 0.8, 1.2, 0.9])
    large = small_motion(np.random.default_rng(9), 1.5, 0.0)

    def error(beta: np.ndarray) -> float:
        return float(np.sqrt((large.residual(beta) ** 2).mean()))

    draws = [small_motion(np.random.default_rng(s), 0.05, 0.02) for s in range(6)]
    own = [error(make(draw, prior=prior).value) for draw in draws]
    rows = [error(ordinary_least_squares(draw).value) for draw in draws]
    assert max(own) < 1.1 * error(prior) and np.median(own) < 0.8 * error(prior)
    assert max(rows) > 5 * error(prior)
    # what the samples determine is not pulled
    clear = well_conditioned(np.random.default_rng(0))
    assert np.abs(make(clear, prior).value - TRUTH).max() < 0.02


def column(w: list[float], tau: list[float]) -> Problem:
    """A problem of one joint and one parameter."""
    return problem(np.array(w)[:, None, None], np.array(tau)[:, None])


THROUGH = column([1.0, 2.0, 3.0], [1.0, 2.0, 4.0])
HALVED = column([1.0, 2.0], [3.0, 1.0])
AXIS = column([2.0, 1.0, -1.0, 1.0], [1.0, 2.0, 1.0, -1.0])
BY_HAND: dict[str, tuple[Estimator, Problem, float]] = {
    # beta = 17 / 14, residual 21 - 17^2 / 14 = 5 / 14
    "line": (ordinary_least_squares, THROUGH, 17 / 14),
    # beta = w.tau / (w.w (1 + lambda)); with a prior of 2 the difference to it is halved
    "ridge": (partial(ridge, choice=1.0), HALVED, 0.5),
    "ridge about 2": (partial(ridge, prior=np.array([2.0]), choice=1.0), HALVED, 1.5),
    # A^T A = [[7, 2], [2, 7]], principal axis (1, 1), slope 1
    "total least squares": (total_least_squares, AXIS, 1.0),
    "of the same points": (ordinary_least_squares, AXIS, 2 / 7),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_values_by_hand(name: str) -> None:
    estimator, given, expected = BY_HAND[name]
    found = estimator(given)
    assert found.value[0] == pytest.approx(expected)
    if name == "line":
        assert found.covariance[0, 0] == pytest.approx(5 / 28 / 14)


REFUSED = {
    "not a number": (not_a_number, r"sample 8, joint 2.*\(a\).*\(b\).*\(c\)"),
    "constant": (constant_trajectory, r"trajectory is constant.*\(a\).*\(b\).*\(c\)"),
    "too few": (too_few, r"1 samples of 3 joints are 3 equations for 4 param.*\(a\)"),
    "columns that depend": (rank_deficient, r"do not determine p4\. Either \(a\)"),
}


@EACH
@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_solved_is_refused(claim: Claim, kind: str) -> None:
    make, message = REFUSED[kind]
    if kind in ("too few", "columns that depend") and not claim.needs_rank:
        pytest.skip("it stays near a prior")
    with pytest.raises(InputError, match=message):
        claim.estimator(make(np.random.default_rng(0)))


@pytest.mark.parametrize(("factor", "size"), [(1000.0, "large"), (0.01, "small")])
def test_torque_in_another_unit_is_suspected_against_the_nominal_arm(
    factor: float, size: str
) -> None:
    given = well_conditioned(np.random.default_rng(0))
    wrong, said = problem(given.matrix, factor * given.torque), f"suspiciously {size}"
    assert said in unit_warnings(wrong, PRIOR)[0]
    assert unit_warnings(given, PRIOR) == ()
    assert any(said in text for text in partial_update(wrong, PRIOR).warnings)


# Physically consistent estimators: bodies that can be, whatever the noise, and torque as well explained.


LINKS = 3


@dataclass(frozen=True)
class Small:
    """Three joints of the iiwa: random states of the nominal arm with white torque noise [N m], in base columns."""

    regressor: Regressor
    base: BaseParameters

    def sampled(self, noise: float, samples: int = 200, seed: int = 0) -> Problem:
        rng = np.random.default_rng(seed)
        q, dq, ddq = (
            scale * rng.standard_normal((samples, LINKS)) for scale in (1.0, 1.0, 3.0)
        )
        Y = self.regressor.matrix(Motion(0.01 * np.arange(samples), q, dq, ddq))
        torque = Y @ self.regressor.nominal()
        torque += noise * rng.standard_normal(torque.shape)
        W, group = Y[..., self.base.kept], np.zeros(samples, int)
        return Problem(W, torque, self.base.kept_names, group, np.full(samples, 0.01))


@pytest.fixture(scope="module")
def small() -> Small:
    regressor = Regressor(replace(iiwa_of_three(), coulomb=np.array([3.0, 3.0, 2.0])))
    return Small(regressor, structural_base(regressor, np.random.default_rng(0)))


BODIES: dict[str, Bodies] = {
    "sdp euclidean": semidefinite,
    "sdp entropic": partial(semidefinite, entropic=True),
    "log-cholesky": log_cholesky,
}
EACH_BODIES = pytest.mark.parametrize("bodies", BODIES.values(), ids=BODIES)


def near(small: Small, bodies: Bodies) -> Estimator:
    """The estimator about 1.1 of the truth."""
    prior = 1.1 * small.regressor.nominal()
    return partial(possible_arm, prior=prior, base=small.base, bodies=bodies)


def bodies_of(small: Small, bodies: Bodies, given: Problem) -> np.ndarray:
    """All parameters that are found about 1.1 of the truth, (p,)."""
    matrix, torque = given.stacked()
    prior = 1.1 * small.regressor.nominal()
    return bodies(matrix @ small.base.combination, torque, prior, small.base.names)[0]


@EACH_BODIES
@pytest.mark.parametrize("noise", [0.1, 5.0])
def test_bodies_are_physical_and_friction_is_not_negative(
    small: Small, bodies: Bodies, noise: float
) -> None:
    value = bodies_of(small, bodies, small.sampled(noise, samples=60))
    links = check_links(value[: 10 * LINKS])
    assert all(link.consistent and link.triangle for link in links)
    assert (value[10 * LINKS : 13 * LINKS] >= 0).all()


@EACH_BODIES
def test_with_noise_other_torque_is_predicted_better_than_without_constraints(
    small: Small, bodies: Bodies
) -> None:
    """On little and noisy data; mean over three draws of the RMSE on 200 other states."""
    # without noise it is explained
    clean = small.sampled(0.0)
    exact = near(small, bodies)(clean).residual
    assert exact.max() < 0.01 * clean.torque.std()
    other = small.sampled(0.0, seed=99)
    draws = [small.sampled(3.0, samples=30, seed=seed) for seed in range(3)]
    own, plain = (
        np.mean([other.residual(estimator(d).value).std() for d in draws])
        for estimator in (near(small, bodies), ordinary_least_squares)
    )
    assert own < 0.7 * plain


def test_a_prior_that_is_no_body_and_another_unit_are_said(small: Small) -> None:
    given, prior = small.sampled(0.1), small.regressor.nominal()
    wrong = replace(given, torque=1e3 * given.torque)
    found = possible_arm(wrong, prior, small.base, log_cholesky)
    assert "suspiciously large" in found.warnings[0]
    prior[10] = -1.0
    with pytest.raises(InputError, match="the prior of link 2 is no physical body"):
        possible_arm(given, prior, small.base, log_cholesky)


# Each estimator with the interval that belongs to it.


THREE = np.array([1.0, -2.0, 0.5])
LINEAR = list(METHODS)[: list(METHODS).index("kalman")]


@pytest.mark.parametrize("name", LINEAR)
def test_intervals_hold_the_truth(name: str) -> None:
    base = BaseParameters(("p1", "p2", "p3"), np.arange(3), np.eye(3))
    # a linear estimator simulates no experiment
    estimator = METHODS[name].make(Given(base, THREE, pytest.fail))
    hits = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        W = rng.standard_normal((300, 2, 3))
        noise = 0.1 * rng.standard_normal((300, 2))
        given = problem(W, W @ THREE + noise, 0.01, groups=2)
        estimate = estimator(given)
        interval = METHODS[name].interval(given, estimator, estimate)
        low, high = interval.interval(estimate.value)
        hits.append((low <= THREE) & (high >= THREE))
    assert 0.88 <= np.mean(hits) <= 1.0


# Partial update: a simulated iiwa's parameters carried over to an arm with other friction and masses 10 % larger.


def test_a_parameter_that_the_data_hardly_move_keeps_its_prior() -> None:
    """Few samples under much noise tell the first parameter alone, which the prior knows least."""
    rng = np.random.default_rng(0)
    W = rng.standard_normal((12, 3, 4)) * [1.0, 1.0, 1.0, 0.1]
    given = problem(W, W @ TRUTH + 2.0 * rng.standard_normal(W.shape[:2]))
    found = partial_update(given, PRIOR)
    assert (found.value == PRIOR).tolist() == [False, True, True, True]


def test_one_parameter_by_hand() -> None:
    """A friction believed to be 1 +- 1, nine samples of 3 under noise s: (1 + 9 * 3 / s^2) / (1 + 9 / s^2)."""
    W = np.ones((9, 1, 1))
    W[:4] = 1 + 1e-7
    tau = 3.0 + np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0])[:, None]
    given = Problem(W, tau, ("c1",), np.zeros(9, int), np.ones(9))
    estimate = partial_update(given, np.ones(1))
    left = tau - estimate.value[0]
    variance = (left**2).mean() * 9 / 8
    found, expected = estimate.value[0], (1 + 27 / variance) / (1 + 9 / variance)
    assert found == pytest.approx(expected, rel=1e-4)
    assert estimate.covariance[0, 0] == pytest.approx(1 / (1 + 9 / variance), rel=1e-4)
