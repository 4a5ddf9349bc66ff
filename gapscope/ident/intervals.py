"""Intervals of identified parameters: noise, repeated motions, refits, and the error of the model's form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, periodogram, sosfreqz
from scipy.signal.windows import tukey
from scipy.stats import chi2
from scipy.stats import f as fisher
from scipy.stats import t as student

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.linear import (
    REWEIGHTINGS,
    SLIGHT,
    Estimate,
    Estimator,
    joint_factors,
    reweighted,
    weighted_factor,
    whitened,
)
from gapscope.ident.model.base_parameters import ROUNDING, TINY, Factor
from gapscope.ident.samples import (
    STRIBECK_TRIED,
    Problem,
    Samples,
    check_rank,
    equal_parts,
    parts_within,
)
from gapscope.model.conditioning import BY_CHANCE, TORQUE_CUTOFF
from gapscope.model.design import PRECISE, WAVES, drawn_waves
from gapscope.model.effective_samples import (
    autocovariance,
    group_slices,
    low_pass_inflation,
    variance_inflation,
)
from gapscope.model.equations import ROUNDS, SETTLED
from gapscope.model.rows import MIN_MOTIONS

# Form error of an identification: what no column has of the friction that an arm has.
#
# Whatever law is chosen, joint j is taken to leave
#
#     y_j = W_j beta + f_j(q_j, dq_j) + e_j,    f_j = sum_k phi_k u_k,    u_k ~ N(0, omega_k^2)
#
# with an unknown function f_j of its own state, as a contrast takes it (``gapscope.model.equations``): waves, which
# are smooth and share one amplitude, and dry functions sgn v exp(-(v / vs)^2) of several speeds vs, each of its own.
# The same motion has the same f again, so that least squares, which takes it for noise, is pulled by it as often as it
# is repeated. An amplitude follows from the evidence (mackay1992b), with gamma the number of values that data
# determine,
#
#     omega^2 = sum u^2 / gamma.


DRY_SPEEDS = (*FRICTION_SMOOTHING * np.array([1, 2, 4]), *STRIBECK_TRIED[:2])
"""Speeds vs of the dry functions [rad/s], from that over which the sign is smoothed. (budget)"""


def form_columns(samples: Samples) -> tuple[np.ndarray, ...]:
    """The unknown functions in the band of the samples: waves, (M, n, K), and each dry function, (M, n, 1)."""
    arm, motions = samples.columns.arm, [s.motion for s in samples.segments]
    n = arm.n_joints

    def state(motion: Motion) -> np.ndarray:
        return np.hstack([motion.q, motion.dq])

    # rad and rad/s cannot be compared: each counts by its own spread
    spread = np.concatenate([state(motion) for motion in motions]).std(axis=0)
    spread = np.maximum(spread, TINY)

    def columns(motion: Motion) -> np.ndarray:
        own, speed = state(motion) / spread, motion.dq / arm.per_radian
        # a joint's friction is a function of its own state, not of the others'
        smooth = [drawn_waves(own[:, [j, n + j]], WAVES[0]) for j in range(n)]
        dry = [np.sign(speed) * np.exp(-((speed / vs) ** 2)) for vs in DRY_SPEEDS]
        return np.concatenate([np.stack(smooth, axis=1), np.stack(dry, axis=2)], axis=2)

    every = samples.filtered_each(columns)
    ends = np.arange(WAVES[0], every.shape[2])
    return tuple(np.split(every, ends, axis=2))


def form_error(problem: Problem, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Noise and amplitudes by the evidence of what an estimate leaves.

    Args:
        problem: with the columns of its unknown functions.
        beta: the estimate, (b,).

    Returns:
        Noise e [N m], (N, n); and E[u u^T] of all functions, joint by joint, as the data leave it, (n K, n K).
    """
    functions = np.concatenate(problem.forms, axis=2)
    (_, n, count), b = functions.shape, len(beta)
    counts = [each.shape[2] for each in problem.forms]
    starts = np.cumsum([0, *counts[:-1]])
    left = problem.residual(beta)
    scale2 = np.maximum((problem.torque**2).mean(axis=0), TINY)
    # amplitudes start at what even a precise arm leaves of its torque
    variance = np.tile(PRECISE**2 * scale2[:, None], count)
    noise, noise2 = left, np.maximum((left**2).mean(axis=0), 1e-18 * scale2)
    # sums of products of [W, functions of the joint, what is left], joint by joint
    parts = [problem.matrix, functions, left[:, :, None]]
    every = np.concatenate(parts, axis=2).transpose(1, 2, 0)
    sums = every @ every.transpose(0, 2, 1)
    unknown = np.repeat([0.0, 1.0], [b, n * count])
    for _ in range(ROUNDS):
        # parameters are shared by all joints, functions belong to one
        gram, right = np.zeros((len(unknown), len(unknown))), np.zeros(len(unknown))
        for j, own in enumerate(sums / noise2[:, None, None]):
            at = np.r_[:b, b + j * count : b + (j + 1) * count]
            gram[np.ix_(at, at)] += own[:-1, :-1]
            right[at] += own[:-1, -1]
        # in units of the columns, and of the amplitudes, so that one that vanishes leaves it regular
        scale = 1 / np.sqrt(np.diag(gram)[:b].clip(TINY))
        size = np.append(scale, np.sqrt(variance))
        information = np.diag(unknown) + gram * np.outer(size, size)
        inner = np.linalg.pinv(information, hermitian=True)
        change, value = np.split(size * (inner @ (size * right)), [b])
        # what the functions take over the estimate gives back
        noise = left - problem.matrix @ change
        noise = noise - np.einsum("njk,jk->nj", functions, value.reshape(n, count))
        inflation = variance_inflation(noise, problem.group)
        noise2 = np.maximum((noise**2).mean(axis=0) * inflation, 1e-18 * scale2)
        # as many as data determine, of the functions that share an amplitude
        determined = (1.0 - np.diag(inner)[b:]).reshape(n, count)
        squares = np.add.reduceat(value.reshape(n, count) ** 2, starts, axis=1)
        gamma = np.add.reduceat(determined, starts, axis=1)
        before = variance
        variance = np.repeat(squares / np.maximum(gamma, TINY), counts, axis=1)
        # what is a millionth of the torque is none
        variance = np.maximum(variance, 1e-12 * scale2[:, None])
        if (np.abs(variance - before) <= SETTLED * before).all():
            break
    # what the data say of one function they say of others too: those that replace each other do not add up
    moment = np.outer(value, value) + (inner * np.outer(size, size))[b:, b:]
    return noise, moment


# Model error distinguished from noise: the residual at the frequencies of the motion against those above.


LOW, FLOOR = 1 / 4, (1 / 3, 1 / 2)
"""Bands of the motion and of the noise floor, as shares of the cut-off: up to 3 Hz and 4 to 6 Hz at 12 Hz."""
DOUBT = 1e-3
"""Chance, over all joints, below which noise alone is not believed."""
TAPER = 0.1
"""Share of a series that is faded in and out before its spectrum is taken."""


def model_error(
    problem: Problem, residual: np.ndarray, cutoff: float = TORQUE_CUTOFF
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split residuals into noise, level up to the cut-off, and model error, which lies where the motion lies.

    The periodogram's mean up to a quarter of the cut-off over its mean from a third to a half of it has Fisher's F
    distribution for noise, with twice the number of ordinates as degrees of freedom. What the low band holds above
    the floor is the variance of the model error.

    Args:
        problem: whose groups and interval count.
        residual: [N m], shape (N, n), better of groups that were not fitted.
        cutoff: of the low-pass that the torque passed [Hz]; Nyquist's frequency if that is lower.

    Returns:
        Standard deviations of the part that follows the motion and of the rest [N m], and how often noise alone would
        look like this [1]; each (n,).

    Source: pintelon2012.
    """
    cutoff, n = min(cutoff, 0.5 / problem.interval.max()), residual.shape[1]
    bands = ((0.0, LOW), FLOOR)
    spans, power, counts = group_slices(problem.group), np.zeros((2, n)), [0, 0]
    for span in spans:
        # a window that rises and falls by half a cosine
        taper = tukey(span.stop - span.start, 2 * TAPER)
        rate = 1 / problem.interval[span.start]
        frequency, density = periodogram(
            residual[span], rate, taper, detrend=False, axis=0
        )
        for k, (least, most) in enumerate(bands):
            inside = (frequency >= least * cutoff) & (frequency <= most * cutoff)
            power[k] += density[inside].sum(axis=0)
            counts[k] += int(inside.sum())
    low, floor = power / np.maximum(counts, 1)[:, None]
    ratio = low / np.maximum(floor, TINY)
    # an ordinate has a real and an imaginary part: two degrees of freedom each
    p_value = fisher.sf(ratio, *(2 * np.maximum(counts, 1)))
    variance = (residual**2).mean(axis=0)
    # the floor is flat: noise has as much density in the low band
    systematic = np.minimum((LOW * cutoff * (low - floor)).clip(0.0), variance)
    return np.sqrt(systematic), np.sqrt(variance - systematic), p_value


# Uncertainty that holds for autocorrelated residuals: block jackknife, intervals.
#
# Filtered recordings have autocorrelated residuals, so that s^2 (W^T W)^-1 states too small errors.
# Both methods here use the scores g_i = W_i^T S^-1 e_i, shape (b,), of samples i as they follow each other.


LEVEL = 0.95
"""Share of parameters, and of samples of torque, that an interval is to hold [1]."""
MAX_BLOCKS = 200
"""Blocks of the jackknife; more only take longer, as Student's t is normal by then [1]."""


@dataclass(frozen=True)
class Uncertainty:
    """A covariance of parameters and how well it is itself known.

    Attributes:
        covariance: shape (b, b).
        freedom: degrees of freedom of its variances, about the number of independent blocks [1].
        by_blocks: the covariance if what the unknown form of the friction does is taken for noise, (b, b); ``None``
            if that is the covariance itself.
    """

    covariance: np.ndarray
    freedom: float
    by_blocks: np.ndarray | None = None

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (b,)."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))

    def interval(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of each parameter's interval, by Student's t; each of shape (b,)."""
        quantile = student.ppf(0.5 + LEVEL / 2, max(self.freedom, 1.0))
        half = quantile * self.deviation
        return value - half, value + half


def block_jackknife(
    problem: Problem, beta: np.ndarray, weight: np.ndarray | None = None
) -> Uncertainty:
    """Covariance (B - 1) / B sum_k d_k d_k^T with d_k the change of beta when block k of B is left out.

    d_k = (A - A_k)^-1 g_k, A = sum W_i^T S W_i, A_k and g_k the block's share of A and its summed score: no block tests
    the parameters that it bent itself. Source: kunsch1989, bell2002.

    Args:
        problem: that was solved.
        beta: the estimate, shape (b,).
        weight: S, the inverse noise covariance that the estimator weighted with, shape (n, n); 1 if ``None``.
    """
    weighted = problem.matrix if weight is None else weight @ problem.matrix

    def by_blocks(residual: np.ndarray) -> Uncertainty:
        return jackknife(weighted, problem.matrix, residual, problem.group)

    alone = by_blocks(problem.residual(beta))
    if not problem.forms:
        return alone
    # what repeats with the motion is in no block alone
    noise, moment = form_error(problem, beta)
    of_noise = by_blocks(noise)
    functions = np.concatenate(problem.forms, axis=2)
    gram = np.einsum("nja,njb->ab", weighted, problem.matrix, optimize=True)
    scores = [weighted[:, j].T @ functions[:, j] for j in range(problem.n_joints)]
    # an estimate that makes Z^T (y - W beta) zero hands f on as (Z^T W)^-1 Z^T f
    pull = np.linalg.solve(gram, np.hstack(scores))
    covariance = of_noise.covariance + pull @ moment @ pull.T
    return replace(of_noise, covariance=covariance, by_blocks=alone.covariance)


def jackknife(
    left: np.ndarray, right: np.ndarray, residual: np.ndarray, group: np.ndarray
) -> Uncertainty:
    """The same for any estimate that makes Z^T e zero, with e = y - W beta, or nearly so near the estimate.

    Blocks are twice as long as those for the variance of a mean, (3 G^2 / (2 g^2))^(1/3) N^(1/3), averaged over
    columns, with g = sum_k R_k and G = sum_k |k| R_k of autocovariances R_k: of an autoregressive series of which f
    samples count as one (``variance_inflation``) G / g is (f^2 - 1) / (2 f). Source: politis2004.

    Args:
        left: Z, instruments, or the regressor by its weights, shape (N, m, b).
        right: W, the regressor, or derivatives of what is predicted, shape (N, m, b).
        residual: e, shape (N, m).
        group: shape (N,).
    """
    parameters = left.shape[2]
    scores = np.einsum("ijb,ij->ib", left, residual)
    gram = left.reshape(-1, parameters).T @ right.reshape(-1, parameters)
    count, f = len(scores), variance_inflation(scores - scores.mean(axis=0), group)
    memory = (f**2 - 1) / (2 * f)
    usual = np.ceil(np.mean((3 / 2 * memory**2 * count) ** (1 / 3)))
    # at the last length ``MAX_BLOCKS`` blocks hold all samples
    length = max(2 * np.clip(usual, 1, max(1, count // 5)), -(-count // MAX_BLOCKS))
    # kg and kg m^2 differ by orders of magnitude: solved with a unit diagonal
    scale = 1 / np.sqrt(np.abs(np.diag(gram)).clip(TINY))
    changes = []
    for block in parts_within(group, length):
        instruments = left[block].reshape(-1, parameters)
        own = instruments.T @ right[block].reshape(-1, parameters)
        others = (gram - own) * np.outer(scale, scale)
        score = scale * scores[block].sum(axis=0)
        # the rest may not determine a direction: the shortest change then
        changes.append(scale * np.linalg.lstsq(others, score, rcond=1e-14)[0])
    return _of_changes(np.array(changes))


def _of_changes(change: np.ndarray) -> Uncertainty:
    """(B - 1) / B sum_k d_k d_k^T of the changes without each of B blocks, (B, b), of B - 1 degrees of freedom."""
    count = len(change)
    covariance = (count - 1) / count * change.T @ change
    return Uncertainty(covariance, max(count - 1.0, 1.0))


# Uncertainty of any estimator: the estimate is repeated without one stretch of time after the other.


STRETCHES = 20
"""About how many stretches of time are left out, one at a time."""


def refit_jackknife(problem: Problem, estimator: Estimator) -> Uncertainty:
    """Covariance (G - 1) / G sum_k (beta_k - mean)(beta_k - mean)^T, beta_k the estimate without stretch k of G.

    It holds for estimators that are not linear in the torque, and counts that samples follow each other. What a pull
    adds as bias is the same in every beta_k, so it is not counted. It has G - 1 degrees of freedom.

    Args:
        problem: that was solved; each stretch belongs to one group.
        estimator: that solved it.

    Raises:
        InputError: the samples without a stretch do not determine the parameters.

    Source: kunsch1989.
    """
    spans = parts_within(problem.group, len(problem.group) / STRETCHES)
    found = np.array(list(_without_each(problem, spans, estimator)))
    change = found - found.mean(axis=0)
    return _of_changes(change)


# Repeated groups: identify each stretch alone; how much the results differ distinguishes noise from model error.


FACTOR = 2.0
"""And the factor by which variances have to differ, since the stated one is itself an estimate."""


@dataclass(frozen=True)
class GroupComparison:
    """Estimates of some groups against what each group states about its own error, as the JSON document has it.

    Attributes:
        count: of the groups.
        stated_std: mean standard error that the groups state, shape (b,).
        std_between: standard deviation of the values between groups, shape (b,).
        ratio: variance between groups over the stated one, all parameters together [1]; 1 if the stated errors hold.
        p_value: how often noise alone gives a ratio this far from 1.
        verdict: ``noise``, ``model error that differs between groups`` or ``model error common to all groups``.
        meaning: what the verdict means for the stated errors.
    """

    count: int
    stated_std: np.ndarray
    std_between: np.ndarray
    ratio: float
    p_value: float
    verdict: str
    meaning: str


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
    groups = group_slices(problem.group)
    # a single recording can only be compared with itself, in parts
    spans = groups if len(groups) > 1 else equal_parts(groups[0], MIN_MOTIONS)
    values, precisions = [], []
    for number, span in enumerate(spans, 1):
        own = problem.rows(span)
        try:
            value = estimator(own).value
        except InputError as error:
            where = f"group {number}"
            raise InputError(error.problem, error.remedy, where=where) from None
        # the group's own precision: equations of unit noise, as it states them
        flat = whitened(own, np.sqrt(_variance(own, value, cutoff)))[0]
        values.append(value)
        precisions.append(flat.T @ flat)
    found, weight = np.array(values), np.array(precisions)
    weighted_sum = np.einsum("gab,gb->a", weight, found)
    mean = np.linalg.solve(weight.sum(axis=0), weighted_sum)
    deviation = found - mean
    statistic = float(np.einsum("ga,gab,gb->", deviation, weight, deviation))
    freedom = (len(found) - 1) * found.shape[1]
    # two-sided: the groups may differ by too much or by too little
    tails = chi2.sf(statistic, freedom), chi2.cdf(statistic, freedom)
    p_value, ratio = 2 * min(map(float, tails)), statistic / freedom
    verdict, meaning = (
        "noise",
        "they differ as much as the errors that they state; an error that all of them share, such as the form of "
        "the friction makes, does not show here",
    )
    surprising = p_value <= BY_CHANCE
    if surprising and ratio >= FACTOR:
        verdict = "model error that differs between groups"
        meaning = (
            f"groups differ by {np.sqrt(ratio):.1f} times the errors they state: bias that changes with the "
            "motion, not noise; the stated errors are too small; look for an effect that the model lacks"
        )
    elif surprising and ratio <= 1 / FACTOR:
        verdict = "model error common to all groups"
        meaning = (
            f"groups agree to {np.sqrt(ratio):.2f} of the errors they state: the residual repeats, "
            "so it is model error common to all groups, not noise; more repetitions will not help; vary the motion"
        )
    stated = np.mean([np.diag(np.linalg.inv(one)) for one in weight], axis=0)
    between = found.std(axis=0, ddof=1)
    return GroupComparison(
        len(found), np.sqrt(stated), between, ratio, p_value, verdict, meaning
    )


def _variance(problem: Problem, beta: np.ndarray, cutoff: float) -> np.ndarray:
    """Of what a fit leaves, as many samples counted as one as the low-pass makes alike [N m^2], (n,)."""
    residual = problem.residual(beta)
    # independent samples add up over intervals
    every, count = np.unique(problem.interval, return_counts=True)
    free_of_memory = [1 / low_pass_inflation(cutoff, interval) for interval in every]
    memory = residual.shape[0] / (count @ free_of_memory)
    # fitting took up some of the independent samples
    free = max(1 - memory * len(beta) / residual.size, 1 / residual.size)
    return np.maximum((residual**2).mean(axis=0) / free * memory, TINY)


# Intervals for the torque that an identified model predicts on other trajectories, model error included.


@dataclass(frozen=True)
class TorqueInterval:
    """How far the arm's torque may lie from the model's, by what was missed of torque that was not fitted; n joints.

    Attributes:
        parameters: how well the model's parameters are known.
        systematic: standard deviation of the model error, the part that follows the motion [N m], shape (n,).
        noise: standard deviation of the rest [N m], shape (n,).
        p_value: how often noise alone would look like this, shape (n,).
        groups: number of groups that showed it.
        torque: standard deviation of the torque [N m], shape (n,).
    """

    parameters: Uncertainty
    systematic: np.ndarray
    noise: np.ndarray
    p_value: np.ndarray
    groups: int
    torque: np.ndarray

    @property
    def found(self) -> np.ndarray:
        """Joints, counted from 1, on which noise alone is not believed."""
        # as many tests as joints: the chance is of any of them
        return np.flatnonzero(self.p_value * len(self.p_value) < DOUBT) + 1

    @property
    def material(self) -> np.ndarray:
        """Those of them, counted from 1, on which it is no slight part of the torque and exceeds the noise."""
        least = np.maximum(SLIGHT * self.torque, self.noise)
        visible = self.systematic > least
        return self.found[visible[self.found - 1]]

    def warnings(self) -> tuple[str, ...]:
        """A warning that names the joints on which model error is material, if there are any."""
        joints = self.material
        if not len(joints):
            return ()
        size = np.hypot(self.systematic, self.noise).clip(TINY)
        share = (self.systematic / size)[joints - 1].max()
        return (
            f"the residual on joint {', '.join(map(str, joints))} is not noise ({share:.0%} of it follows the "
            "motion): the model lacks an effect, and s^2 (W^T W)^-1 states too small errors; use intervals that count "
            "model error, and `gapscope diagnose` to name the effect; record slow and fast motions apart, slow ones "
            "for friction and gravity, fast ones for inertia, and validate each on the other",
        )

    def half_width(self, matrix: np.ndarray, *, recorded: bool = False) -> np.ndarray:
        """Half the width of the interval [N m], shape (N, n), about W beta.

        t sqrt(v + s^2), v = W C W^T with the parameters' covariance C, and the model error s of each joint. Student's
        t has (v + s^2)^2 / (v^2 / f + s^4 / (G - 1)) degrees of freedom (Welch and Satterthwaite), f those of C, and
        G groups: another motion's model error is one more draw beside theirs.

        Args:
            matrix: W of the other trajectory, shape (N, n, b).
            recorded: of the torque as it would be recorded, noise included, instead of the torque itself.
        """
        # what the form moves in the parameters it gives back in torque; what it leaves there is model error
        covariance = self.parameters.by_blocks
        # where no unknown form was counted there is one covariance
        if covariance is None:
            covariance = self.parameters.covariance
        own = ((matrix @ covariance) * matrix).sum(axis=2)
        systematic = self.systematic**2
        variance = own + systematic
        # Welch and Satterthwaite
        own_part = own**2 / max(self.parameters.freedom, 1.0)
        systematic_part = systematic**2 / max(self.groups - 1, 1)
        parts = np.maximum(own_part + systematic_part, TINY)
        freedom = np.maximum(variance**2 / parts, 1.0)
        noise = self.noise**2 if recorded else 0.0
        return student.ppf(0.5 + LEVEL / 2, freedom) * np.sqrt(variance + noise)


@dataclass(frozen=True)
class PredictedTorque:
    """Intervals of predicted torque on some recordings, n joints, as the JSON document has them.

    Attributes:
        level: share of samples that an interval is to hold [1].
        half_width: RMS half width for the arm's torque [N m], shape (n,).
        half_width_recorded: the same for the torque as it is recorded, noise included [N m], shape (n,).
        held: share of recorded samples within the latter [1], shape (n,).
        model_error, noise, p_value: as in ``TorqueInterval``, shape (n,).
        joints_with_model_error: joints, from 1, on which noise alone is not believed.
    """

    level: float
    half_width: np.ndarray
    half_width_recorded: np.ndarray
    held: np.ndarray
    model_error: np.ndarray
    noise: np.ndarray
    p_value: np.ndarray
    joints_with_model_error: np.ndarray


def predicted_torque(
    interval: TorqueInterval, problem: Problem, beta: np.ndarray
) -> PredictedTorque:
    """Intervals on recordings that were not fitted, and how many of their samples lie within.

    Args:
        interval: of the model.
        problem: other recordings in the same base columns.
        beta: what is predicted with, shape (b,).
    """
    own, recorded = (
        interval.half_width(problem.matrix, recorded=noisy) for noisy in (False, True)
    )
    held = (np.abs(problem.residual(beta)) <= recorded).mean(axis=0)
    return PredictedTorque(
        level=LEVEL,
        half_width=rms(own),
        half_width_recorded=rms(recorded),
        held=held,
        model_error=interval.systematic,
        noise=interval.noise,
        p_value=interval.p_value,
        joints_with_model_error=interval.found,
    )


def torque_interval(
    problem: Problem,
    estimator: Estimator,
    uncertainty: Uncertainty,
    cutoff: float = TORQUE_CUTOFF,
    estimate: Estimate | None = None,
) -> TorqueInterval:
    """Intervals from torque held out: each group is predicted by the model that the others give.

    Groups miss torque of each other by their parameters alone, in the mean square by W_k C_-k W_k^T with C_-k the
    covariance that weighted least squares has of the parameters from the other groups, by what the whole leaves. Few
    directions may make most of it: its distribution is about that of chi-squared with (sum l)^2 / sum l^2 degrees of
    freedom, l the variances of the directions (Welch and Satterthwaite).

    Args:
        problem: whose groups are cut into equal parts, at least ``MIN_MOTIONS`` in all.
        estimator: of the model.
        uncertainty: of its parameters.
        cutoff: of the low-pass that the torque passed [Hz].
        estimate: of the whole problem; estimated if ``None``.

    Raises:
        InputError: the other groups do not determine the parameters.
    """
    estimate = estimate or estimator(problem)
    groups = group_slices(problem.group)
    pieces = -(-MIN_MOTIONS // len(groups))  # rounded up
    spans = [part for rows in groups for part in equal_parts(rows, pieces)]
    lengths = [span.stop - span.start for span in spans]
    problem = replace(problem, group=np.repeat(np.arange(len(spans)), lengths))
    if len(spans) < 2:
        raise InputError(
            "too few samples to hold any out", "record for longer", where="samples"
        )
    # of each group under the estimate of the others
    residual = np.empty_like(problem.torque)
    values = _without_each(problem, spans, estimator)
    for span, value in zip(spans, values, strict=True):
        residual[span] = problem.rows(span).residual(value)
    systematic, noise, p_value = model_error(problem, residual, cutoff)
    # what the other groups do not determine is no error of the model
    variance, n = _variance(problem, estimate.value, cutoff), problem.n_joints
    weighted = problem.matrix / np.sqrt(variance)[:, None]
    flat = [weighted[span].reshape(-1, len(estimate.value)) for span in spans]
    grams = [part.T @ part for part in flat]
    total = np.sum(grams, axis=0)
    unit = 1 / np.sqrt(np.diag(total).clip(TINY))
    sums, squares = np.zeros(n), np.zeros(n)
    # without its own rows: what the others know of the parameters
    for span, gram in zip(spans, grams, strict=True):
        known, vectors = np.linalg.eigh((total - gram) * np.outer(unit, unit))
        # a direction that the others do not determine at all is missed by any amount
        spread = (weighted[span] * unit) @ (vectors / np.sqrt(known.clip(ROUNDING**2)))
        own = np.einsum("ijb,ijc->jbc", spread, spread, optimize=True)
        # the trace is the sum of l, the norm squared the sum of l^2
        sums += np.trace(own, axis1=1, axis2=2)
        squares += (own**2).sum(axis=(1, 2))
    missed2 = np.maximum(variance * sums / len(problem.torque), TINY)
    freedom = np.maximum(sums**2 / np.maximum(squares, TINY), 1.0)
    # noise in the parameters alone makes their ratio chi-squared over its degrees
    by_chance = chi2.sf(freedom * systematic**2 / missed2, freedom)
    return TorqueInterval(
        parameters=uncertainty,
        systematic=np.sqrt((systematic**2 - missed2).clip(0.0)),
        noise=noise,
        # the less surprising explanation counts: noise, or parameters
        p_value=np.maximum(p_value, by_chance),
        groups=len(spans),
        torque=problem.torque.std(axis=0),
    )


def _without_each(
    problem: Problem, spans: Sequence[slice], estimator: Estimator
) -> Iterator[np.ndarray]:
    """Estimates without each group, (b,)."""
    rounds = REWEIGHTINGS.get(estimator)
    if rounds is not None:
        # the equations of a group are made a triangle once, not for each of the others again
        parts = [joint_factors(problem.rows(span)) for span in spans]
        for k in range(len(spans)):
            others = zip(*(parts[:k] + parts[k + 1 :]), strict=True)
            joints = [Factor.together(own) for own in others]
            check_rank(weighted_factor(joints).triangle, problem.names)
            yield reweighted(joints, rounds).solve()
        return
    for span in spans:
        kept = np.ones(len(problem.torque), dtype=bool)
        kept[span] = False
        yield estimator(problem.rows(kept)).value


# Whether a residual is noise.


LAGS = 20
"""Lags of the test for whiteness."""


@dataclass(frozen=True)
class Whiteness:
    """Whether residuals are what the band leaves of white noise, sampled at the cut-off, n joints; as the JSON has it.

    Attributes:
        ljung_box: Ljung and Box's Q over ``LAGS`` lags [1], shape (n,).
        p_value: how often white noise has a larger one, shape (n,).
        level: p value from which on a residual may be noise [1].
        white: joints whose residual may be, shape (n,).
        largest_autocorrelation: largest beyond the band's own at lags from 1 [1], shape (n,).
        bound: what white noise stays below with 99 % probability at any one lag [1].
    """

    ljung_box: np.ndarray
    p_value: np.ndarray
    level: float
    white: np.ndarray
    largest_autocorrelation: np.ndarray
    bound: float


def whiteness(
    residual: np.ndarray, group: np.ndarray, rate: np.ndarray, cutoff: float
) -> Whiteness:
    """Ljung and Box's test, Q = N (N + 2) sum_{k=1}^{m} (rho_k - rho0_k)^2 / (N - k), chi-squared of m degrees.

    rho0 is the autocorrelation of noise that has passed the band. The test sees the N samples that the band holds.

    Args:
        residual: [N m], in the band, shape (M, n).
        group: stretch that a sample belongs to, shape (M,).
        rate: of the stretch that a sample belongs to [Hz], shape (M,).
        cutoff: of the band [Hz].

    Source: ljung1978.
    """
    kept, correlations = [], []
    for rows in group_slices(group):
        own = float(rate[rows.start])
        step = max(1, round(own / cutoff))
        kept.append(np.arange(rows.start, rows.stop, step))
        # the autocorrelation that the zero-phase low-pass gives white noise, at the lags of the samples that are seen
        filter_ = butter(4, min(cutoff, 0.95 * own / 2), output="sos", fs=own)
        frequency, response = sosfreqz(filter_, 4096, fs=own)
        # forward and backward: the power gain is the fourth power of the response
        power = np.abs(response) ** 4
        phase = 2 * np.pi * np.arange(LAGS + 1)[:, None] * step / own * frequency
        # Wiener and Khinchin: the correlation is the cosine transform of the power
        covariance = (power * np.cos(phase)).sum(axis=1)
        correlations.append(covariance / covariance[0])
    expected = np.average(correlations, axis=0, weights=[len(own) for own in kept])
    seen = np.concatenate(kept)
    residual, group = residual[seen], group[seen]
    n = len(residual)
    # later lags have too few pairs to say anything
    lags = max(1, min(LAGS, n // 4))
    covariance = autocovariance(residual - residual.mean(axis=0), group, lags)
    rho = covariance[1:] / np.maximum(covariance[0], TINY)
    beyond_band = rho - expected[1 : lags + 1, None]
    pairs = (n - np.arange(1, lags + 1))[:, None]
    statistic = n * (n + 2) * (beyond_band**2 / pairs).sum(axis=0)
    p_value = chi2.sf(statistic, lags)
    largest = np.abs(beyond_band).max(axis=0)
    # 99 % of the correlations of white noise lie within this
    bound = float(2.576 / np.sqrt(n))
    return Whiteness(statistic, p_value, DOUBT, p_value > DOUBT, largest, bound)
