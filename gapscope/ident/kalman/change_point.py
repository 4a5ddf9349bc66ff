"""When parameters changed during a recording, and by how much: a two-sided fit over all moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from gapscope.arm.errors import InputError
from gapscope.ident.kalman.whitening import white
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem

ROUNDS = 3
"""Rounds of noise model and search."""
REMOVED = 2
"""Changes that are fitted before the effect of model errors is estimated."""
SHARE = 0.05
"""A change lowers the whitened squared residual by at least this share [1]."""
STANDS_OUT = 3.0
"""A change is distinguished from errors of the model if it is likelier by this factor in 2 log L."""


@dataclass(frozen=True)
class ChangeHypothesis:
    """What may change at once, beta' = beta + D delta.

    Attributes:
        name: in words, such as ``payload``.
        names: of the elements of delta, shape (s,).
        directions: D, shape (b, s).
    """

    name: str
    names: tuple[str, ...]
    directions: np.ndarray


@dataclass(frozen=True)
class ParameterChange:
    """A change of parameters.

    Attributes:
        hypothesis: what changed.
        time: when [s].
        interval: between which moments it happened, with 95 % confidence [s].
        size: delta, shape (s,), in the units of the hypothesis.
        covariance: of it, shape (s, s), the moment taken as known.
        statistic: twice the log-likelihood ratio against no change, divided by its threshold [1].
    """

    hypothesis: ChangeHypothesis
    time: float
    interval: tuple[float, float]
    size: np.ndarray
    covariance: np.ndarray
    statistic: float

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors of the size, shape (s,)."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))


def payload_hypothesis(base: BaseParameters, link: int) -> ChangeHypothesis:
    """A payload picked up or put down: mass [kg] and first moment [kg m] of a link, in the frame of its joint.

    Its inertia about that frame, m c^2, is left out: it is small against rotor and link if the load is near.

    Args:
        base: the base parameters of the problem.
        link: that carries it, counted from 1.
    """
    names = tuple(f"{kind}{link}" for kind in ("m", "mx", "my", "mz"))
    places = [base.names.index(name) for name in names]
    return ChangeHypothesis("payload", names, base.combination[:, places])


def friction_hypothesis(base: BaseParameters, joint: int) -> ChangeHypothesis:
    """Viscous [N m s/rad] and Coulomb friction [N m] of a joint, counted from 1, changed."""
    both = (f"b{joint}", f"c{joint}")
    names = tuple(name for name in both if name in base.names)
    if not names:
        raise InputError(
            f"the problem has no friction of joint {joint}",
            "give the regressor friction columns",
        )
    places = [base.names.index(name) for name in names]
    return ChangeHypothesis(
        f"friction of joint {joint}", names, base.combination[:, places]
    )


def find_change(
    problem: Problem,
    t: np.ndarray,
    hypotheses: Sequence[ChangeHypothesis],
    *,
    false_alarms: float = 1e-3,
    margin: float = 0.4,
) -> ParameterChange | None:
    """The likeliest change, or ``None`` if none is certain.

    For every moment T the model tau = W (beta + 1(t > T) D delta) + noise is fitted to the whole record, beta free, by
    cumulative sums: with A, s the sums of W^T W and W^T tau, A', s' those after T,

        F = D^T (A' - A' A^-1 A') D,   u = D^T (s' - A' A^-1 s),   delta = F^-1 u,   2 log L = u^T F^-1 u.

    The noise is made white first, by an autoregression per joint fitted to what the best model so far leaves. Without a
    change 2 log L is chi-squared with s degrees of freedom at each T; the threshold is its quantile at alpha over the
    number of moments and hypotheses tried. Of several hypotheses the one with the least tail probability is taken.

    Errors of the model make 2 log L large at every moment, not at one: the likeliest two changes are fitted, and by how
    far the median of 2 log L for a further one exceeds that of chi-squared, or its peak the threshold, that is raised.
    And 2 log L must be at least ``SHARE`` of the number of equations: less cannot be distinguished from errors of the
    model.

    Args:
        problem: one stretch, or several in the order of time.
        t: times of its samples [s], shape (N,).
        hypotheses: what may change.
        false_alarms: alpha, probability of any change if there is none [1].
        margin: time from both ends in which no change is looked for [s].

    Raises:
        InputError: the record is too short for the margin and the parameters.

    Source: basseville1993.
    """
    t = np.asarray(t, dtype=float)
    moments = np.flatnonzero((t > t[0] + margin) & (t < t[-1] - margin))
    parameters = problem.matrix.shape[2]
    # two fits, before and after, need twice the equations
    if len(moments) < 2 or problem.torque.size < 2 * parameters:
        raise InputError(
            f"{t[-1] - t[0]:.3g} s with {problem.torque.size} equations for {parameters} parameters are "
            "too short to distinguish a change from none",
            "record for longer, or take fewer parameters as unknown",
            where="t",
        )
    whitened, best = _best_scan(problem, moments, hypotheses)
    chance = false_alarms / (len(moments) * len(hypotheses))
    # Bonferroni's bound over all moments and hypotheses
    threshold = float(chi2.isf(chance, len(best.hypothesis.names)))
    # errors of the model are estimated only if there is something to explain
    if best.peak > threshold:
        threshold *= _usual(whitened, best, moments, threshold)
    threshold = max(threshold, SHARE * problem.torque.size)
    if best.peak <= threshold:
        return None
    # moments whose likelihood ratio is not significantly lower than the best one's
    near = t[moments[best.statistic > best.peak - chi2.ppf(0.95, 1)]]
    return ParameterChange(
        best.hypothesis,
        float(t[best.moment]),
        (float(near.min()), float(near.max())),
        best.size,
        best.covariance,
        best.peak / threshold,
    )


def _best_scan(
    problem: Problem,
    moments: np.ndarray,
    hypotheses: Sequence[ChangeHypothesis],
) -> tuple[Problem, _Scan]:
    """The problem with white noise, and the scan of the likeliest hypothesis; noise and change found in turns."""
    best: _Scan | None = None
    for _ in range(ROUNDS):
        whitened = white(problem, _residual(problem, best))
        sums = _Sums.of(whitened, moments)
        scans = [_Scan.over(sums, hypothesis) for hypothesis in hypotheses]
        # hypotheses differ in the number of parameters: compared by tail probability
        best = max(scans, key=lambda scan: scan.evidence)
    assert best is not None
    return whitened, best


@dataclass(frozen=True)
class _Sums:
    """Sums over a problem with columns scaled to RMS 1: over all samples, and over those after each moment.

    Attributes:
        moments: T of them, places in the record, shape (T,).
        scale: RMS of the columns, shape (b,).
        inverse: A^-1, shape (b, b).
        right: s, shape (b,).
        gram_after, right_after: A' and s' of each moment, shapes (T, b, b) and (T, b).
    """

    moments: np.ndarray
    scale: np.ndarray
    inverse: np.ndarray
    right: np.ndarray
    gram_after: np.ndarray
    right_after: np.ndarray

    @classmethod
    def of(cls, problem: Problem, moments: np.ndarray) -> _Sums:
        rms = np.sqrt(np.mean(problem.matrix**2, axis=(0, 1)))
        scale = np.maximum(rms, 1e-12)
        W = problem.matrix / scale
        gram = np.cumsum(np.matmul(W.transpose(0, 2, 1), W), axis=0)
        right = np.cumsum(np.einsum("kja,kj->ka", W, problem.torque), axis=0)
        return cls(
            moments=moments,
            scale=scale,
            inverse=np.linalg.pinv(gram[-1], hermitian=True),
            right=right[-1],
            gram_after=gram[-1] - gram[moments],
            right_after=right[-1] - right[moments],
        )


@dataclass(frozen=True)
class _Scan:
    """One hypothesis at all moments: 2 log L (T,), and at its peak the place, delta and its covariance."""

    hypothesis: ChangeHypothesis
    statistic: np.ndarray
    moment: int
    size: np.ndarray
    covariance: np.ndarray

    @property
    def peak(self) -> float:
        return float(self.statistic.max())

    @property
    def evidence(self) -> float:
        """Minus log of the tail probability, whatever the number of parameters."""
        return -float(chi2.logsf(self.peak, len(self.size)))

    @classmethod
    def over(cls, sums: _Sums, hypothesis: ChangeHypothesis) -> _Scan:
        D = hypothesis.directions * sums.scale[:, None]
        # A' D and A^-1 A' D of each moment
        after = sums.gram_after @ D
        projected = sums.inverse @ after
        information = D.T @ after - after.transpose(0, 2, 1) @ projected
        explained = np.einsum("kas,a->ks", projected, sums.right)
        score = sums.right_after @ D - explained
        covariance = np.linalg.pinv(information, hermitian=True, rcond=1e-10)
        size = np.einsum("kst,kt->ks", covariance, score)
        statistic = np.einsum("ks,ks->k", size, score)
        k = int(statistic.argmax())
        return cls(
            hypothesis=hypothesis,
            statistic=statistic,
            moment=int(sums.moments[k]),
            size=size[k],
            covariance=covariance[k],
        )


def _usual(
    problem: Problem, scan: _Scan, moments: np.ndarray, threshold: float
) -> float:
    """How much larger 2 log L is than without errors of the model, at least 1, when ``REMOVED`` changes are fitted."""
    hypothesis = scan.hypothesis
    s = len(hypothesis.names)
    for _ in range(REMOVED):
        problem = replace(
            problem,
            matrix=_with_change(problem.matrix, scan.moment, hypothesis),
            names=(*problem.names, *hypothesis.names),
        )
        # a further change of the same parameters; those of the changes that are fitted stay
        directions = np.concatenate([hypothesis.directions, np.zeros((s, s))])
        hypothesis = ChangeHypothesis(hypothesis.name, hypothesis.names, directions)
        scan = _Scan.over(_Sums.of(problem, moments), hypothesis)
    everywhere = float(np.median(scan.statistic) / chi2.median(s))
    next_peak = STANDS_OUT * scan.peak / threshold
    return max(1.0, everywhere, next_peak)


def _with_change(
    matrix: np.ndarray, moment: int, hypothesis: ChangeHypothesis
) -> np.ndarray:
    """W with columns for a change of the hypothesis after a moment, shape (N, n, b + s)."""
    after = (np.arange(len(matrix)) > moment)[:, None, None]
    return np.concatenate([matrix, after * (matrix @ hypothesis.directions)], axis=2)


def _residual(problem: Problem, scan: _Scan | None) -> np.ndarray:
    """Residual of the model with the change found so far [N m], shape (N, n)."""
    W = problem.matrix
    if scan is not None:
        W = _with_change(W, scan.moment, scan.hypothesis)
    stacked = W.reshape(-1, W.shape[2])
    scale = np.maximum(np.linalg.norm(stacked, axis=0), 1e-12)
    torque = problem.torque.ravel()
    fit = np.linalg.lstsq(stacked / scale, torque, rcond=None)[0]
    return problem.torque - (W / scale) @ fit
