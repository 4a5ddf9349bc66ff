"""When parameters changed during a recording, and by how much: a two-sided fit over all moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from gapscope.arm.errors import InputError
from gapscope.ident.kalman.change_hypothesis import ChangeHypothesis
from gapscope.ident.kalman.change_scan import ChangeScan, ChangeSums, push_gain
from gapscope.ident.kalman.tail import log_chance
from gapscope.ident.kalman.whitening import white
from gapscope.ident.model.linear_problem import Problem

ROUNDS = 3
"""Rounds of noise model and search."""
REMOVED = 2
"""Changes that are fitted before the effect of model errors is estimated."""
SHARE = 0.05
"""A change lowers the whitened squared residual by at least this share [1]."""
FADING = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Time constants of fading friction that are tried, over the length of the record [1]."""
PUSH_TIME = 3.0
"""Longest push that is tried in place of a change [s]."""
PUSH_NEAR = 0.5
"""A push begins or ends as near to the moment of a change [s]."""
STANDS_OUT = 3.0
"""A change is distinguished from errors of the model if it is likelier by this factor in 2 log L."""


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


def find_change(
    problem: Problem,
    t: np.ndarray,
    hypotheses: Sequence[ChangeHypothesis],
    *,
    false_alarms: float = 1e-3,
    margin: float = 0.4,
    pushes: np.ndarray | None = None,
) -> ParameterChange | None:
    """The likeliest change, or ``None`` if none is certain.

    For every moment T the model tau = W (beta + 1(t > T) D delta) + noise is fitted to the whole record, beta free, by
    cumulative sums: with A, s the sums of W^T W and W^T tau, A', s' those after T,

        F = D^T (A' - A' A^-1 A') D,   u = D^T (s' - A' A^-1 s),   delta = F^-1 u,   2 log L = u^T F^-1 u.

    What may change beside (N) is fitted along, and 2 log L is the gain over N alone. Friction that fades exponentially
    from the start of the record on is another model: a change has to be likelier than that, with any time constant.

    The noise is made white first, by an autoregression per joint fitted to what the best model so far leaves. Without a
    change 2 log L is chi-squared with s degrees of freedom at each T; the threshold is its quantile at alpha over the
    number of moments and hypotheses tried. Of several hypotheses the one with the least tail probability is taken.

    Errors of the model make 2 log L large at every moment, not at one: the likeliest two changes are fitted, and by how
    far the median of 2 log L for a further one exceeds that of chi-squared, or its peak the threshold, that is raised.
    A push against the arm is no change, and would pass for one: if constants on all joints explain more for a while of
    up to ``PUSH_TIME`` that begins or ends near the moment, nothing has changed for good.
    And 2 log L must be at least ``SHARE`` of the number of equations: less cannot be distinguished from errors of the
    model.

    Args:
        problem: one stretch, or several in the order of time.
        t: times of its samples [s], shape (N,).
        hypotheses: what may change.
        false_alarms: alpha, probability of any change if there is none [1].
        margin: time from both ends in which no change is looked for [s].
        pushes: directions of the parameters that a push changes, constants on the joints, (b, n); none is tried if
            ``None``.

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
    least = SHARE * problem.torque.size
    # errors of the model, and friction that fades, are estimated only if there is something to explain
    if best.peak <= max(threshold, least):
        return None
    threshold = max(threshold * _usual(whitened, best, moments, threshold), least)
    if best.peak <= max(threshold, _fading(whitened, t, best.hypothesis)):
        return None
    if pushes is not None and _is_push(whitened, t, best, pushes):
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
) -> tuple[Problem, ChangeScan]:
    """The problem with white noise, and the scan of the likeliest hypothesis; noise and change found in turns."""
    best: ChangeScan | None = None
    for _ in range(ROUNDS):
        whitened = white(problem, _residual(problem, best))
        sums = ChangeSums.of(whitened, moments)
        scans = [ChangeScan.over(sums, hypothesis) for hypothesis in hypotheses]
        # hypotheses differ in the number of parameters: compared by tail probability
        before, best = best, max(scans, key=lambda scan: scan.evidence)
        # the same change leaves the same residual, and with it the same noise
        if before is not None and _same(before, best):
            break
    assert best is not None
    return whitened, best


def _same(one: ChangeScan, other: ChangeScan) -> bool:
    """Whether two scans find the same change at the same moment."""
    return one.hypothesis is other.hypothesis and one.moment == other.moment


def _fading(problem: Problem, t: np.ndarray, hypothesis: ChangeHypothesis) -> float:
    """The largest 2 log L of D delta exp(-t / T) in place of a change, over time constants T; 0 if it cannot fade."""
    if not hypothesis.fades:
        return 0.0
    since = t - t[0]
    own = problem.matrix @ hypothesis.directions
    unchanged = _sum_of_squares(problem, problem.matrix)
    best = 0.0
    for share in FADING:
        fading = np.exp(-since / (share * since[-1]))[:, None, None] * own
        columns = np.concatenate([problem.matrix, fading], axis=2)
        best = max(best, unchanged - _sum_of_squares(problem, columns))
    return best


def _is_push(
    problem: Problem, t: np.ndarray, best: ChangeScan, directions: np.ndarray
) -> bool:
    """Whether a push near the moment of a change is likelier than that, whose tail probability it has to undercut."""
    longest = round(PUSH_TIME / float(np.median(np.diff(t))))
    # samples of a long record lie too far apart to show one
    if not longest:
        return False
    ends = np.flatnonzero(np.abs(t[:-1] - t[best.moment]) <= PUSH_NEAR)
    sums = ChangeSums.of(problem, np.arange(len(t) - 1))
    gain = push_gain(sums, directions, ends, longest)
    # each while that was tried had its chance
    tried = np.log(len(ends) * 2 * longest)
    return log_chance(gain, directions.shape[1]) - tried > best.evidence


def _sum_of_squares(problem: Problem, columns: np.ndarray) -> float:
    """What least squares with some columns, (N, n, c), leaves of the torque."""
    return float(np.sum(_left(columns, problem.torque) ** 2))


def _usual(
    problem: Problem, scan: ChangeScan, moments: np.ndarray, threshold: float
) -> float:
    """How much larger 2 log L is than without errors of the model, at least 1, when ``REMOVED`` changes are fitted."""
    hypothesis = scan.hypothesis
    s = len(hypothesis.names)
    for _ in range(REMOVED):
        matrix = _with_change(problem.matrix, scan.moment, hypothesis)
        added = matrix.shape[2] - problem.matrix.shape[2]
        names = (*problem.names, *(f"change {k}" for k in range(added)))
        problem = replace(problem, matrix=matrix, names=names)
        # a further change of the same parameters; those of the changes that are fitted stay
        hypothesis = hypothesis.widened(added)
        scan = ChangeScan.over(ChangeSums.of(problem, moments), hypothesis)
    everywhere = float(np.median(scan.statistic) / chi2.median(s))
    next_peak = STANDS_OUT * scan.peak / threshold
    return max(1.0, everywhere, next_peak)


def _with_change(
    matrix: np.ndarray, moment: int, hypothesis: ChangeHypothesis
) -> np.ndarray:
    """W with columns for a change of the hypothesis, and beside it, after a moment, shape (N, n, b + s + r)."""
    after = (np.arange(len(matrix)) > moment)[:, None, None]
    return np.concatenate(
        [matrix, after * (matrix @ hypothesis.all_directions)], axis=2
    )


def _residual(problem: Problem, scan: ChangeScan | None) -> np.ndarray:
    """Residual of the model with the change found so far [N m], shape (N, n)."""
    W = problem.matrix
    if scan is not None:
        W = _with_change(W, scan.moment, scan.hypothesis)
    return _left(W, problem.torque)


def _left(columns: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Residual of least squares with some columns, (N, n, c), shape (N, n)."""
    stacked = columns.reshape(-1, columns.shape[2])
    scale = np.maximum(np.linalg.norm(stacked, axis=0), 1e-12)
    fit = np.linalg.lstsq(stacked / scale, torque.ravel(), rcond=None)[0]
    return torque - (columns / scale) @ fit
