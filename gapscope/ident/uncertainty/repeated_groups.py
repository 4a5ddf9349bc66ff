"""Repeated groups: identify each stretch alone; how much the results differ distinguishes noise from model error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimator
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import several_groups
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.effective_samples import low_pass_inflation

DOUBT = 0.01
"""Chance below which noise alone is not believed."""
FACTOR = 2.0
"""And the factor by which variances have to differ, since the stated one is itself an estimate."""


@dataclass(frozen=True)
class GroupComparison:
    """Estimates of G groups against what each group states about its own error.

    Attributes:
        values: shape (G, b).
        stated: mean variance that the groups state, shape (b,).
        between: variance of the values between groups, shape (b,).
        ratio: between over stated variance, all parameters together [1]; 1 if the stated errors hold.
        p_value: how often noise alone gives a ratio this far from 1.
        verdict: ``noise``, ``model error that differs between groups`` or ``model error common to all groups``.
    """

    values: np.ndarray
    stated: np.ndarray
    between: np.ndarray
    ratio: float
    p_value: float
    verdict: str

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the verdict means for the stated errors."""
        if self.verdict == "noise":
            return ()
        if self.ratio > 1:
            return (
                f"groups differ by {np.sqrt(self.ratio):.1f} times the errors they state: bias that changes with the "
                "motion, not noise; the stated errors are too small; look for an effect that the model lacks",
            )
        return (
            f"groups agree to {np.sqrt(self.ratio):.2f} of the errors they state: the residual repeats, "
            "so it is model error common to all groups, not noise; more repetitions will not help; vary the motion",
        )


def compare_groups(
    problem: Problem, estimator: Estimator, cutoff: float = TORQUE_CUTOFF
) -> GroupComparison:
    """Split into groups, identify each, and compare variance between groups with the variance that they state.

    The statistic is sum_g (beta_g - mean)^T C_g^-1 (beta_g - mean), chi-squared with (G - 1) b degrees of freedom for
    noise, C_g the group's own covariance s^2 (W^T W)^-1 per joint, inflated by what the low-pass makes noise remember,
    and the mean weighted by C_g^-1. Over groups of different motion a missing effect biases each differently: the
    ratio of statistic and degrees exceeds 1. Over repetitions of one motion it biases all alike, and the residual
    torque, taken for noise, makes the groups state more than they differ: the ratio falls below 1.

    Args:
        problem: groups as ``problem.group``; a single one is cut into four.
        estimator: whose estimate of a group is to be compared; weights of the estimator are not known here, so the
            statement holds for estimators near weighted least squares.
        cutoff: of the low-pass that the torque passed [Hz].

    Raises:
        InputError: a group by itself does not determine the parameters.
    """
    values, precisions = [], []
    for number, span in enumerate(several_groups(problem.group), 1):
        own = problem.rows(span)
        try:
            value = estimator.estimate(own).value
        except InputError as error:
            raise InputError(
                error.problem, error.remedy, where=f"group {number}"
            ) from None
        values.append(value)
        precisions.append(_precision(own, value, cutoff))
    found, weight = np.array(values), np.array(precisions)
    weighted_sum = np.einsum("gab,gb->a", weight, found)
    mean = np.linalg.solve(weight.sum(axis=0), weighted_sum)
    deviation = found - mean
    statistic = float(np.einsum("ga,gab,gb->", deviation, weight, deviation))
    freedom = (len(found) - 1) * found.shape[1]
    # two-sided: the groups may differ by too much or by too little
    upper, lower = chi2.sf(statistic, freedom), chi2.cdf(statistic, freedom)
    p_value = 2 * min(float(upper), float(lower))
    stated = np.mean([np.diag(np.linalg.inv(one)) for one in weight], axis=0)
    between = found.var(axis=0, ddof=1)
    ratio = statistic / freedom
    verdict = _verdict(ratio, p_value)
    return GroupComparison(
        values=found,
        stated=stated,
        between=between,
        ratio=ratio,
        p_value=p_value,
        verdict=verdict,
    )


def _verdict(ratio: float, p_value: float) -> str:
    if p_value > DOUBT or 1 / FACTOR < ratio < FACTOR:
        return "noise"
    return (
        f"model error {'that differs between' if ratio > 1 else 'common to all'} groups"
    )


def _precision(problem: Problem, beta: np.ndarray, cutoff: float) -> np.ndarray:
    """C_g^-1 of one group, shape (b, b)."""
    residual = problem.residual(beta)
    size = residual.size
    memory = low_pass_inflation(cutoff, problem.interval)
    # fitting took up some of the independent samples
    free = max(1 - memory * len(beta) / size, 1 / size)
    variance = np.maximum((residual**2).mean(axis=0) / free * memory, 1e-300)
    weighted = problem.matrix / np.sqrt(variance)[:, None]
    flat = weighted.reshape(-1, len(beta))
    return np.asarray(flat.T @ flat)
