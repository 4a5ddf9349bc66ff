"""The estimators by name: how each is made for an arm, and which interval belongs to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from gapscope.arm.nearest_name import check_known
from gapscope.ident.estimators.linear import (
    Estimate,
    Estimator,
    huber,
    least_noise,
    maximum_likelihood,
    noise_across,
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
from gapscope.ident.estimators.simulating import (
    Experiment,
    direct_inverse,
    instrumental_variables,
    output_error,
)
from gapscope.ident.intervals import (
    MAX_BLOCKS,
    STRETCHES,
    Uncertainty,
    block_jackknife,
    refit_jackknife,
)
from gapscope.ident.kalman import kalman
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.samples import Problem


@dataclass(frozen=True)
class Given:
    """What an estimator may be made from.

    Attributes:
        base: base parameters.
        nominal: x of the nominal arm, shape (p,).
        experiment: the recordings and how to repeat them; raises ``InputError`` if they cannot be.
        strength: of a ridge, chosen by held-out motions if ``None``.
        directions: kept of a truncated decomposition, likewise.
    """

    base: BaseParameters
    nominal: np.ndarray
    experiment: Callable[[], Experiment]
    strength: float | None = None
    directions: int | None = None

    @property
    def prior(self) -> np.ndarray:
        """The base parameters of the nominal arm, shape (b,)."""
        return self.base.of(self.nominal)


Interval = Callable[[Problem, Estimator, Estimate], Uncertainty]
"""Uncertainty of the estimate that an estimator made of a problem."""


class Method(NamedTuple):
    """An estimator of base parameters: how it is made, its interval, and what that is, in words."""

    make: Callable[[Given], Estimator]
    interval: Interval
    kind: str


def method(name: str) -> Method:
    """The method of a name; raises ``InputError`` if there is none."""
    check_known("estimator", name, METHODS, where="--estimator")
    return METHODS[name]


def _by_joint(
    problem: Problem, estimator: Estimator, estimate: Estimate
) -> Uncertainty:
    noise = least_noise(estimate.residual, float(np.abs(problem.torque).max()))
    return block_jackknife(problem, estimate.value, np.diag(noise**-2.0))


def _repeated(
    problem: Problem, estimator: Estimator, estimate: Estimate
) -> Uncertainty:
    return refit_jackknife(problem, estimator)


def _stated(problem: Problem, estimator: Estimator, estimate: Estimate) -> Uncertainty:
    freedom = estimate.freedom
    if freedom is None:
        freedom = float(max(problem.torque.size - len(estimate.value), 1))
    return Uncertainty(estimate.covariance, freedom)


_BLOCKS = f"block jackknife, the estimate without each of up to {MAX_BLOCKS} stretches of time"
_WITH_FORM = f"{_BLOCKS}, and what the unknown form of the friction may do"
_JACKKNIFE = f"block jackknife, the estimate repeated without each of about {STRETCHES} stretches of time"
_UNBIASED = f"{_JACKKNIFE}; the bias of the pull is not counted"


def _plain(
    estimator: Estimator, interval: Interval = _repeated, kind: str = _JACKKNIFE
) -> Method:
    """A method that needs the problem alone."""
    return Method(lambda given: estimator, interval, kind)


def _possible(bodies: Bodies) -> Method:
    def make(given: Given) -> Estimator:
        return partial(
            possible_arm, prior=given.nominal, base=given.base, bodies=bodies
        )

    return Method(make, _repeated, _UNBIASED)


def _simulating(estimator: Callable[..., Estimate]) -> Method:
    def make(given: Given) -> Estimator:
        return partial(estimator, experiment=given.experiment())

    return Method(make, _stated, _BLOCKS)


SIMULATING = {
    "instrumental_variables": _simulating(instrumental_variables),
    "didim": _simulating(direct_inverse),
    "output_error": _simulating(output_error),
}
"""Methods that repeat the recordings in simulation, with Coulomb and viscous friction only."""
METHODS: dict[str, Method] = {
    "consistent": _plain(
        weighted_least_squares,
        _by_joint,
        f"{_WITH_FORM}, of weighted least squares without the constraints",
    ),
    "wls": _plain(weighted_least_squares, _by_joint, _WITH_FORM),
    "ols": _plain(
        ordinary_least_squares,
        lambda problem, _, estimate: block_jackknife(problem, estimate.value),
        _WITH_FORM,
    ),
    "irls": _plain(
        huber,
        # without a stretch the estimate is nearly the same
        lambda problem, _, estimate: refit_jackknife(
            problem, partial(huber, start=estimate.value)
        ),
    ),
    "ridge": Method(
        lambda given: partial(ridge, prior=given.prior, choice=given.strength),
        _repeated,
        _UNBIASED,
    ),
    "l_curve": Method(
        lambda given: partial(ridge, prior=given.prior, choice="l_curve"),
        _repeated,
        _UNBIASED,
    ),
    "truncated_svd": Method(
        lambda given: partial(truncated_svd, prior=given.prior, count=given.directions),
        _repeated,
        _UNBIASED,
    ),
    "total_least_squares": _plain(total_least_squares),
    "maximum_likelihood": _plain(
        maximum_likelihood,
        lambda problem, _, estimate: block_jackknife(
            problem,
            estimate.value,
            np.linalg.inv(noise_across(problem, estimate.value)),
        ),
        _WITH_FORM,
    ),
    "kalman": _plain(
        kalman,
        _stated,
        "covariance of the filter, which counts that samples follow each other",
    ),
    "partial_update": Method(
        lambda given: partial(partial_update, prior=given.prior),
        _stated,
        "posterior, of the data and the nominal arm together",
    ),
    "log_cholesky": _possible(log_cholesky),
    "sdp_euclidean": _possible(semidefinite),
    "sdp_entropic": _possible(partial(semidefinite, entropic=True)),
    **SIMULATING,
}
"""Methods by name; ``consistent`` is weighted least squares constrained to bodies that can exist."""
