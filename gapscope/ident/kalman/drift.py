"""Friction that warms up, from the track of a filter: how much of it fades, and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.effects.friction import drift_change
from gapscope.ident.model.linear_problem import Problem

LONGEST = 20.0
"""A time constant of more than this many durations of the record cannot be distinguished from a line."""


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
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputError(
            f"{', '.join(unknown)} is no parameter of the problem",
            where="names",
        )
    places = [known.index(name) for name in names]
    model = _WarmingModel(problem, t, places, noise)
    duration = float(t[-1] - t[0])
    # a and log T; the least T is four samples
    lower = [-0.95, np.log(4 * problem.interval)]
    upper = [5.0, np.log(LONGEST * duration)]
    fits = []
    for share in (0.1, 0.3, 1.0):
        start = [0.3, np.log(share * duration)]
        fits.append(
            least_squares(
                model.residual, start, bounds=(lower, upper), x_scale=(0.1, 0.3)
            )
        )
    # several starts: the cost has local minima in the time constant
    best = min(fits, key=lambda fit: fit.cost)
    if not best.success:
        raise GapscopeError(
            "the search for the time constant did not end",
            "record for longer, from the cold arm on",
        )
    amplitude, constant = float(best.x[0]), float(np.exp(best.x[1]))
    # from log T to T
    chain = np.diag([1.0, constant])
    variance = 2 * best.cost / (problem.torque.size - len(known) - 2)
    information = best.jac.T @ best.jac
    covariance = chain @ np.linalg.pinv(information) @ chain * variance
    warnings: tuple[str, ...] = ()
    if duration < constant:
        warnings = (
            f"the time constant, {constant:.3g} s, is longer than the record of {duration:.3g} s; record for longer",
        )
    friction = model.linear_part(best.x)[places]
    return Warming(
        warm=friction,
        amplitude=amplitude,
        time_constant=constant,
        covariance=covariance,
        warnings=warnings,
    )


class _WarmingModel:
    """tau = W beta + a exp(-t / T) W_f beta_f over the noise, with the best beta for given a and log T."""

    def __init__(
        self, problem: Problem, t: np.ndarray, places: list[int], noise: np.ndarray
    ) -> None:
        self._W = problem.matrix / noise[:, None]
        self._tau = (problem.torque / noise).ravel()
        self._t, self._places = t, places

    def linear_part(self, x: np.ndarray) -> np.ndarray:
        """The best beta, shape (b,)."""
        return self._best(self._columns(x))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Weighted torque less the model with the best beta [1], shape (N n,)."""
        columns = self._columns(x)
        return self._tau - columns @ self._best(columns)

    def _best(self, columns: np.ndarray) -> np.ndarray:
        norm = np.linalg.norm(columns, axis=0)
        return np.linalg.lstsq(columns / norm, self._tau, rcond=None)[0] / norm

    def _columns(self, x: np.ndarray) -> np.ndarray:
        factor = 1.0 + drift_change(self._t, x[0], np.exp(x[1]))
        varied = self._W.copy()
        varied[:, :, self._places] *= factor[:, None, None]
        return varied.reshape(len(self._tau), -1)
