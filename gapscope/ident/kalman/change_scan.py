"""A change hypothesis at every moment of a problem, by cumulative sums."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.kalman.change_hypothesis import ChangeHypothesis
from gapscope.ident.kalman.tail import log_chance
from gapscope.ident.model.linear_problem import Problem

DEPENDENT = 1e-10
"""Directions of columns of RMS 1 with less than this share of the largest power are not determined [1]."""
LEAST_LEFT = 1e-6
"""Nor are changes of whose power over the whole record beta leaves less than this share [1]: it may be rounding alone,
as where a joint has moved at one speed until the moment."""


@dataclass(frozen=True)
class ChangeSums:
    """Sums over a problem with columns scaled to RMS 1: over all samples, and over those after each moment.

    Attributes:
        moments: T of them, places in the record, shape (T,).
        scale: RMS of the columns, shape (b,).
        columns: W, shape (N, n, b).
        gram: A, shape (b, b).
        inverse: A^-1, shape (b, b).
        right: s, shape (b,).
        right_after: s' of each moment, shape (T, b).
    """

    moments: np.ndarray
    scale: np.ndarray
    columns: np.ndarray
    gram: np.ndarray
    inverse: np.ndarray
    right: np.ndarray
    right_after: np.ndarray

    @classmethod
    def of(cls, problem: Problem, moments: np.ndarray) -> ChangeSums:
        """Sums of a problem, its samples in the order of time, at T moments."""
        rms = np.sqrt(np.mean(problem.matrix**2, axis=(0, 1)))
        scale = np.maximum(rms, 1e-12)
        W = problem.matrix / scale
        stacked = W.reshape(-1, W.shape[2])
        gram = stacked.T @ stacked
        right = np.cumsum(np.einsum("kja,kj->ka", W, problem.torque), axis=0)
        return cls(
            moments=moments,
            scale=scale,
            columns=W,
            gram=gram,
            inverse=np.linalg.pinv(gram, hermitian=True, rcond=DEPENDENT),
            right=right[-1],
            right_after=right[-1] - right[moments],
        )

    def after(self, directions: np.ndarray) -> np.ndarray:
        """A' D of each moment for D (b, s), shape (T, b, s)."""
        # A' itself is never formed: of b by b numbers at each moment few are needed
        W = self.columns
        up_to = np.cumsum(W.transpose(0, 2, 1) @ (W @ directions), axis=0)
        return np.asarray(self.gram @ directions - up_to[self.moments])


@dataclass(frozen=True)
class ChangeScan:
    """One hypothesis at all moments: 2 log L (T,), and at its peak the place, delta and its covariance."""

    hypothesis: ChangeHypothesis
    statistic: np.ndarray
    moment: int
    size: np.ndarray
    covariance: np.ndarray

    @property
    def peak(self) -> float:
        """The largest 2 log L."""
        return float(self.statistic.max())

    @property
    def evidence(self) -> float:
        """Minus log of the tail probability of the peak, whatever the number of parameters."""
        return log_chance(self.peak, len(self.size))

    @classmethod
    def over(cls, sums: ChangeSums, hypothesis: ChangeHypothesis) -> ChangeScan:
        """The hypothesis at the moments of some sums."""
        s = len(hypothesis.names)
        D = hypothesis.all_directions * sums.scale[:, None]
        # A' D and A^-1 A' D of each moment
        after = sums.after(D)
        projected = sums.inverse @ after
        information = D.T @ after - after.transpose(0, 2, 1) @ projected
        explained = np.einsum("kas,a->ks", projected, sums.right)
        score = sums.right_after @ D - explained
        power = np.einsum("as,ab,bs->s", D, sums.gram, D)
        covariance = _inverse(information, power)
        size = np.einsum("kst,kt->ks", covariance, score)
        statistic = np.einsum("ks,ks->k", size, score)
        beside = _inverse(information[:, s:, s:], power[s:])
        statistic -= np.einsum("ks,kst,kt->k", score[:, s:], beside, score[:, s:])
        k = int(statistic.argmax())
        return cls(
            hypothesis=hypothesis,
            statistic=statistic,
            moment=int(sums.moments[k]),
            size=size[k, :s],
            covariance=covariance[k, :s, :s],
        )


def push_gain(
    sums: ChangeSums, directions: np.ndarray, ends: np.ndarray, longest: int
) -> float:
    """The largest 2 log L of parameters that change by D delta for a while and then are as before.

    Args:
        sums: of a problem, at T moments.
        directions: D, shape (b, s).
        ends: places in ``moments`` at which the while may end or begin.
        longest: most moments that it lasts.
    """
    D = directions * sums.scale[:, None]
    after = sums.after(D)
    projected = sums.inverse @ after
    power = np.einsum("as,ab,bs->s", D, sums.gram, D)
    best = 0.0
    for end in ends:
        near = np.arange(max(0, end - longest), min(len(after), end + longest + 1))
        # the sums of a while are the difference of those after its two ends
        sign = np.where(near < end, 1.0, -1.0)[:, None, None]
        during = sign * (after[near] - after[end])
        left = sign * (projected[near] - projected[end])
        right = sign[..., 0] * (sums.right_after[near] - sums.right_after[end])
        information = D.T @ during - during.transpose(0, 2, 1) @ left
        score = right @ D - np.einsum("kas,a->ks", left, sums.right)
        inverse = _inverse(information, power)
        gains = np.einsum("ks,kst,kt->k", score, inverse, score)
        best = max(best, float(gains.max()))
    return best


def _inverse(information: np.ndarray, power: np.ndarray) -> np.ndarray:
    """F^-1 at each moment, (T, s, s), without directions of which little of their power, (s,), is left."""
    size = np.sqrt(np.maximum(power, 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    inverted = np.where(values > LEAST_LEFT, 1.0 / np.maximum(values, LEAST_LEFT), 0.0)
    inverse = (vectors * inverted[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(inverse / np.outer(size, size))
