"""Friction that warms up, from the track of a filter: how much of it fades, and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.effects.friction import drift_change
from gapscope.ident.model.linear_problem import Problem

LONGEST = 20.0
"""A time constant of more than this many durations of the record cannot be separated from a line."""


@dataclass(frozen=True)
class Warming:
    """Friction f (1 + a exp(-t / T)), as the effect ``friction_drift`` has it.

    Attributes:
        warm: f of each parameter followed, in its unit, shape (k,).
        amplitude: a [1].
        time_constant: T [s].
        covariance: of (a, T), shape (2, 2).
        warnings: what makes it doubtful.
    """

    warm: np.ndarray
    amplitude: float
    time_constant: float
    covariance: np.ndarray
    warnings: tuple[str, ...] = ()


def fit_warming(
    problem: Problem, t: np.ndarray, names: tuple[str, ...], noise: np.ndarray
) -> Warming:
    """Amplitude and time constant that friction parameters of one joint share.

    Least squares on tau = W beta + a exp(-t / T) W_f beta_f: linear in beta for given a and T, so that only these two
    are searched for (variable projection). Times count from when the arm was cold.

    Args:
        problem: in the order of time.
        t: times of its samples [s], shape (N,).
        names: of the friction parameters f that warm up, such as ``b2``, ``c2``.
        noise: standard deviation of the torque [N m], shape (n,).

    Raises:
        InputError: a name is no parameter of the problem.
        GapscopeError: the search does not end.

    Source: bittencourt2012, golub1973.
    """
    known = list(problem.names)
    if not set(names) <= set(known):
        raise InputError(
            f"{', '.join(sorted(set(names) - set(known)))} is no parameter of the problem",
            where="names",
        )
    places = [known.index(name) for name in names]
    W = problem.matrix / noise[:, None]
    tau = (problem.torque / noise).ravel()
    duration = float(t[-1] - t[0])

    def solved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        varied = W.copy()
        varied[:, :, places] *= 1.0 + drift_change(t, x[0], np.exp(x[1]))[:, None, None]
        flat = varied.reshape(len(tau), -1)
        scale = np.linalg.norm(flat, axis=0)
        beta = np.linalg.lstsq(flat / scale, tau, rcond=None)[0] / scale
        return beta, tau - flat @ beta

    starts = [np.array([0.3, np.log(share * duration)]) for share in (0.1, 0.3, 1.0)]
    bounds = ([-0.95, np.log(4 * problem.interval)], [5.0, np.log(LONGEST * duration)])
    fits = [
        least_squares(lambda x: solved(x)[1], x0, bounds=bounds, x_scale=(0.1, 0.3))
        for x0 in starts
    ]
    best = min(fits, key=lambda fit: fit.cost)
    if not best.success:
        raise GapscopeError(
            "the search for the time constant did not end",
            "record for longer, from the cold arm on",
        )
    a, T = float(best.x[0]), float(np.exp(best.x[1]))
    chain = np.diag([1.0, T])
    spread = 2 * best.cost / (len(tau) - W.shape[2] - 2)
    covariance = chain @ np.linalg.pinv(best.jac.T @ best.jac) @ chain * spread
    warnings: tuple[str, ...] = ()
    if duration < T:
        warnings = (
            f"the time constant, {T:.3g} s, is longer than the record of {duration:.3g} s; record for longer",
        )
    return Warming(solved(best.x)[0][places], a, T, covariance, warnings)
