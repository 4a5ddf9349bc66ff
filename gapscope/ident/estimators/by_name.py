"""The estimators by name: how each is made for an arm, and which interval belongs to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.linear import (
    Estimate,
    Estimator,
    HuberLeastSquares,
    MaximumLikelihood,
    PartialUpdate,
    Ridge,
    TotalLeastSquares,
    TruncatedSvd,
    WeightedLeastSquares,
    least_noise,
)
from gapscope.ident.estimators.physical import ConsistentSdp, LogCholesky
from gapscope.ident.estimators.simulating import (
    DirectInverse,
    InstrumentalVariables,
    OutputError,
)
from gapscope.ident.intervals import (
    MAX_BLOCKS,
    STRETCHES,
    Uncertainty,
    block_jackknife,
    refit_jackknife,
)
from gapscope.ident.kalman import Kalman
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem


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


Make = Callable[[Given], Estimator]
Interval = Callable[[Problem, Estimator, Estimate], Uncertainty]


@dataclass(frozen=True)
class Method:
    """An estimator of base parameters and its interval.

    Attributes:
        make: the estimator.
        interval: uncertainty of its estimate.
        kind: of the interval, in words.
        simulates: whether it repeats the recordings in simulation, with Coulomb and viscous friction only.
    """

    make: Make
    interval: Interval
    kind: str
    simulates: bool = False


def method(name: str) -> Method:
    """The method of a name; raises ``InputError`` if there is none."""
    if name not in METHODS:
        raise InputError(
            f"unknown estimator {name!r}",
            f"use {', '.join(METHODS)}",
            where="--estimator",
        )
    return METHODS[name]


def _by_joint(
    problem: Problem, estimator: Estimator, estimate: Estimate
) -> Uncertainty:
    noise = least_noise(estimate.residual, float(np.abs(problem.torque).max()))
    return block_jackknife(problem, estimate.value, np.diag(noise**-2.0))


def _unweighted(
    problem: Problem, estimator: Estimator, estimate: Estimate
) -> Uncertainty:
    return block_jackknife(problem, estimate.value)


def _across(problem: Problem, estimator: Estimator, estimate: Estimate) -> Uncertainty:
    return block_jackknife(
        problem,
        estimate.value,
        np.linalg.inv(MaximumLikelihood.noise(problem, estimate.value)),
    )


def _repeated(
    problem: Problem, estimator: Estimator, estimate: Estimate
) -> Uncertainty:
    return refit_jackknife(problem, estimator)


def _robust(problem: Problem, estimator: Estimator, estimate: Estimate) -> Uncertainty:
    # without a stretch the estimate is nearly the same
    return refit_jackknife(problem, HuberLeastSquares(start=estimate.value))


def _stated(problem: Problem, estimator: Estimator, estimate: Estimate) -> Uncertainty:
    freedom = estimate.freedom
    if freedom is None:
        freedom = float(max(problem.torque.size - len(estimate.value), 1))
    return Uncertainty(estimate.covariance, freedom, 1)


_BLOCKS = f"block jackknife, the estimate without each of up to {MAX_BLOCKS} stretches of time"
_WITH_FORM = f"{_BLOCKS}, and what the unknown form of the friction may do"
_JACKKNIFE = f"block jackknife, the estimate repeated without each of about {STRETCHES} stretches of time"
_UNBIASED = f"{_JACKKNIFE}; the bias of the pull is not counted"

METHODS: dict[str, Method] = {
    "consistent": Method(
        lambda given: WeightedLeastSquares(),
        _by_joint,
        f"{_WITH_FORM}, of weighted least squares without the constraints",
    ),
    "wls": Method(lambda given: WeightedLeastSquares(), _by_joint, _WITH_FORM),
    "ols": Method(
        lambda given: WeightedLeastSquares(rounds=0), _unweighted, _WITH_FORM
    ),
    "irls": Method(lambda given: HuberLeastSquares(), _robust, _JACKKNIFE),
    "ridge": Method(
        lambda given: Ridge(
            "motion" if given.strength is None else given.strength, given.prior
        ),
        _repeated,
        _UNBIASED,
    ),
    "l_curve": Method(
        lambda given: Ridge("l_curve", given.prior), _repeated, _UNBIASED
    ),
    "truncated_svd": Method(
        lambda given: TruncatedSvd(given.prior, given.directions),
        _repeated,
        _UNBIASED,
    ),
    "total_least_squares": Method(
        lambda given: TotalLeastSquares(), _repeated, _JACKKNIFE
    ),
    "maximum_likelihood": Method(
        lambda given: MaximumLikelihood(), _across, _WITH_FORM
    ),
    "kalman": Method(
        lambda given: Kalman(),
        _stated,
        "covariance of the filter, which counts that samples follow each other",
    ),
    "partial_update": Method(
        lambda given: PartialUpdate(given.prior),
        _stated,
        "posterior, of the data and the nominal arm together",
    ),
    "log_cholesky": Method(
        lambda given: LogCholesky(given.nominal, given.base),
        _repeated,
        _UNBIASED,
    ),
    "sdp_euclidean": Method(
        lambda given: ConsistentSdp(given.nominal, given.base),
        _repeated,
        _UNBIASED,
    ),
    "sdp_entropic": Method(
        lambda given: ConsistentSdp(given.nominal, given.base, entropic=True),
        _repeated,
        _UNBIASED,
    ),
    "instrumental_variables": Method(
        lambda given: InstrumentalVariables(given.experiment()),
        _stated,
        _BLOCKS,
        simulates=True,
    ),
    "didim": Method(
        lambda given: DirectInverse(given.experiment()),
        _stated,
        _BLOCKS,
        simulates=True,
    ),
    "output_error": Method(
        lambda given: OutputError(given.experiment()),
        _stated,
        _BLOCKS,
        simulates=True,
    ),
}
"""Methods by name; ``consistent`` is weighted least squares constrained to bodies that can exist."""
