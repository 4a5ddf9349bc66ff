"""Whether parameters differ between the blocks before a moment and those after it, and which hypothesis explains it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.kalman.change_hypothesis import ChangeHypothesis
from gapscope.ident.kalman.online.estimate import ParameterState

RIDGE = 1e-9
"""Added to the unit diagonal of an information matrix before it is inverted [1]."""


@dataclass(frozen=True)
class HypothesisFit:
    """One hypothesis at one moment.

    Attributes:
        hypothesis: what changed.
        statistic: 2 log L [1], chi-squared with as many degrees of freedom as the hypothesis has parameters.
        size: delta, shape (s,).
        covariance: of it, shape (s, s).
    """

    hypothesis: ChangeHypothesis
    statistic: float
    size: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class BeforeAfter:
    """What the blocks after a moment say beside the filter's estimate before it.

    With x, P the estimate before, C = P + Q its covariance after the moment if nothing changed, and A, s the sums of
    the blocks after, u = s - A x is the innovation in the form of a score, of covariance A + A C A. For a change D
    delta of the parameters

        J = (I + A C)^-1 A,   g = (I + A C)^-1 u,   F = D^T J D,   h = D^T g,   delta = F^-1 h,   2 log L = h^T F^-1 h.

    Q holds what may differ after any moment without being a change: parameters that wander, and the error of the
    model, which fits another motion with other values. Source: willsky1976.

    Attributes:
        information: J, shape (p, p).
        score: g, shape (p,).
    """

    information: np.ndarray
    score: np.ndarray

    @classmethod
    def of(
        cls, before: ParameterState, allowed: np.ndarray, A: np.ndarray, s: np.ndarray
    ) -> BeforeAfter:
        """The comparison at one moment.

        Args:
            before: x and P.
            allowed: diagonal of Q, shape (p,).
            A: sum of W^T W / sigma^2 over the samples after the moment, shape (p, p).
            s: sum of W^T r / sigma^2 over them, shape (p,).
        """
        C = before.covariance + np.diag(allowed)
        both = np.column_stack([A, s - A @ before.value])
        solved = np.linalg.solve(np.eye(len(C)) + A @ C, both)
        return cls(0.5 * (solved[:, :-1] + solved[:, :-1].T), solved[:, -1])

    def fit(self, hypothesis: ChangeHypothesis) -> HypothesisFit:
        """A hypothesis; its statistic is the gain over what may change beside it alone."""
        s = len(hypothesis.names)
        D = hypothesis.all_directions
        F, h = D.T @ self.information @ D, D.T @ self.score
        size, covariance, statistic = _solved(F, h)
        if D.shape[1] > s:
            statistic -= _solved(F[s:, s:], h[s:])[2]
        return HypothesisFit(hypothesis, statistic, size[:s], covariance[:s, :s])

    def of_anything(self, prior: np.ndarray) -> tuple[float, float]:
        """2 log L if all parameters may change by a plausible amount, and its effective degrees of freedom [1].

        Args:
            prior: standard deviations of such changes, shape (p,): the root of the diagonal of P0. The statistic is
                g^T (J + P0^-1)^-1 g, the degrees of freedom trace(J (J + P0^-1)^-1).
        """
        scaled = self.information * prior[:, None] * prior
        inverse = np.linalg.inv(scaled + np.eye(len(prior)))
        g = prior * self.score
        return float(g @ inverse @ g), float(np.trace(scaled @ inverse))


def _solved(F: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """F^-1 h, F^-1 and h^T F^-1 h; directions of which nothing is known are left at zero."""
    # parameters differ by orders of magnitude: a unit diagonal, and a ridge for directions that look alike
    diagonal = np.diag(F)
    known = diagonal > 0
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    unit = F * scale[:, None] * scale + RIDGE * np.eye(len(h))
    inverse = np.linalg.inv(unit) * scale[:, None] * scale
    size = inverse @ h
    return size, inverse, float(h @ size)
