"""What a reading leaves of the torque when bodies and friction are free: columns and their fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.robots import shifted_body
from gapscope.diagnosis.gap.plausible_data import folds_of
from gapscope.diagnosis.thresholds import (
    FAULT_GAIN,
    FAULT_PRIOR_ODDS,
    FAULT_SAMPLES,
    FAULT_SIGN_WIDTH,
    LOWEST_TORQUE_SCALE,
    MIN_TORQUE_DEVIATION,
    MIN_WEIGHT,
    MOTION_INDEPENDENT_RATE,
    ORDINARY_GAP,
    ORDINARY_GAP_DEVIATION,
    ORDINARY_PENALTY,
    ORDINARY_WEIGHT,
    PRIOR_STD_FRICTION,
    PRIOR_STD_INERTIALS,
    PRIOR_STD_LEVER,
    PRIOR_STD_LOAD,
    PRIOR_STD_OFFSET,
    PRIOR_STD_ROTOR,
    PRIOR_STD_SPRING,
    PRIOR_STD_TILT,
    PRIOR_STD_TORQUE_SCALE,
    TORQUE_SHIFT_STEP,
    TORQUE_SHIFTS,
    WORST_GAP,
)
from gapscope.effects.environment import tilt
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass
from gapscope.model.effective_samples import motion_samples
from gapscope.model.gravity_direction import gravity_by_torque, turn_of_base

# What the test for setup faults looks at: few samples of each recording, spread over its length.


@dataclass(frozen=True)
class FaultSamples:
    """Samples of a case, M in all, of n joints, in K folds.

    Attributes:
        q, dq, ddq: recorded motion [rad], [rad/s], [rad/s^2], shape (M, n).
        later_tau: recorded torque after the 12 Hz filter [N m], at the time of the sample plus each of
            ``TORQUE_SHIFTS``, (S, M, n).
        edges: row at which each fold begins, and the end, (K + 1,).
        weight: independent samples per row [1].
        load: inertial parameters of the known body on the last link, (M, 10); zeros if there was none.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    later_tau: np.ndarray
    edges: tuple[int, ...]
    weight: float
    load: np.ndarray

    @property
    def folds(self) -> list[slice]:
        """The rows of each fold."""
        return [
            slice(a, b) for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)
        ]

    def torque(self, delay: float = 0.0) -> np.ndarray:
        """Recorded torque [N m] at the time of the samples plus a delay [s], (M, n), linear between shifts."""
        place = min(delay / TORQUE_SHIFT_STEP, len(self.later_tau) - 1.0)
        before = int(place)
        after = min(before + 1, len(self.later_tau) - 1)
        share = place - before
        return (1 - share) * self.later_tau[before] + share * self.later_tau[after]

    def thinned(self, step: int) -> FaultSamples:
        """Every ``step``-th sample of each fold."""
        rows = [np.arange(f.start, f.stop)[step // 2 :: step] for f in self.folds]
        kept = np.concatenate(rows)
        return FaultSamples(
            self.q[kept],
            self.dq[kept],
            self.ddq[kept],
            self.later_tau[:, kept],
            _edges([len(r) for r in rows]),
            min(1.0, self.weight * step),
            self.load[kept],
        )


def sample(recordings: Sequence[list[Segment]]) -> FaultSamples:
    """Samples of the segments of each recording, in folds."""
    folds = folds_of(recordings)
    segments = [segment for fold in folds for segment in fold]
    sample_counts = [len(s.motion.t[s.inner]) for s in segments]
    seconds = sum(
        count / s.motion.rate for count, s in zip(sample_counts, segments, strict=True)
    )
    step = max(1, math.ceil(sum(sample_counts) / FAULT_SAMPLES))
    rows = [np.concatenate([_thin(s, step) for s in fold], axis=1) for fold in folds]
    q, dq, ddq = np.concatenate(rows, axis=1)
    later_tau = [_later_torque(s, step) for s in segments]
    return FaultSamples(
        q,
        dq,
        ddq,
        np.concatenate(later_tau, axis=1),
        _edges([r.shape[1] for r in rows]),
        min(1.0, motion_samples(seconds, MOTION_INDEPENDENT_RATE) / len(q)),
        np.concatenate([_load(s, step) for s in segments]),
    )


def _edges(lengths: list[int]) -> tuple[int, ...]:
    """First row of each fold of these lengths, and the end."""
    return (0, *itertools.accumulate(lengths))


def _thin(segment: Segment, step: int) -> np.ndarray:
    """q, dq, ddq of every ``step``-th sample, shape (3, M, n)."""
    motion = segment.motion
    trimmed = np.stack([motion.q, motion.dq, motion.ddq])[:, segment.inner]
    return trimmed[:, step // 2 :: step]


def _later_torque(segment: Segment, step: int) -> np.ndarray:
    """Torque at the times of ``_thin``'s rows plus each of ``TORQUE_SHIFTS``, shape (S, M, n).

    What is trimmed from the end of a segment is longer than the largest shift.
    """
    assert segment.torque is not None
    motion = segment.motion
    tau = low_pass(segment.torque, motion.rate, TORQUE_CUTOFF)
    t = motion.t[segment.inner][step // 2 :: step]
    spline = make_interp_spline(motion.t, tau, k=3)
    return np.stack([spline(t + shift) for shift in TORQUE_SHIFTS])


def _load(segment: Segment, step: int) -> np.ndarray:
    """Inertial parameters of the known body on the last link for the rows of ``_thin``, shape (M, 10)."""
    rows = len(segment.motion.t[segment.inner][step // 2 :: step])
    if segment.payload is None:
        return np.zeros((rows, 10))
    return np.tile(segment.payload.parameters, (rows, 1))


# What an arm may ordinarily have beyond its data sheet, fitted under every reading of its recordings.
#
# The torque of joint j is taken as
#
#     tau_j = (1 + k_j) p_j + Y_j delta + a_j ddq_j + (c0_j + c_j) sgn dq_j + (b0_j + b_j) dq_j + s_j q_j + o_j
#
# with p the torque that the nominal arm's bodies and rotors need, known payload included, c0 and b0 its friction, Y
# the inertial regressor and delta errors of the inertials, a load on the last link among them, common to all joints.
# All values have a wide normal prior around zero; that of friction is at least as wide as the nominal friction, which
# is often a placeholder and may be gone, and that of rotors allows for one that takes most of its joint's torque.
# What physics forbids is forbidden: friction and rotor inertia in all not negative, the torque's scale not below 0.4.
# A wrong sign, column or unit cannot be had by ordinary values then.


OWN = 6
"""Values of each joint of its own: scale, rotor, Coulomb, viscous, spring, offset."""
ROTOR, COULOMB, VISCOUS, OFFSET = 1, 2, 3, 5
"""Places of the rotor, the friction coefficients and the offset among them."""


@dataclass(frozen=True)
class MappedTorque:
    """The torque as a reading reads it, against the columns of ``FoldEquations``; K folds, n joints.

    Attributes:
        cross: X_j^T tau_j, (K, n, D).
        square: tau_j^2 summed, (K, n).
        pull: tau_j times the gravity torque g_j, summed, (K, n).
        deviation: standard deviation of each joint's torque [N m], (n,); of the recorded one, whether gravity was left
            out of it or not: gaps with and without it compare as they are.
    """

    cross: np.ndarray
    square: np.ndarray
    pull: np.ndarray
    deviation: np.ndarray


@dataclass(frozen=True)
class FoldEquations:
    """Normal equations of each fold and joint under one reading of the motion, K folds, n joints.

    X_j = [Y_j scale, t_j, p_j, ddq_j, sgn dq_j, dq_j, q_j, 1] has D = 10 n + 8 columns: those of the inertial errors
    and of the base's tilt, which all joints share, and those of the joint's own values.

    Attributes:
        gram: X^T X, (K, n, D, D).
        cross: X^T b for every torque b, the recorded columns and then each joint's gravity torque, (K, n, D, 2 n).
        products: b_i b_j summed, (K, 2 n, 2 n).
        rows: rows of each fold, (K,).
        deviation: standard deviation of each recorded torque column [N m], (n,).
        weight: independent samples per row.
        lowest: lower bounds of rotor [kg m^2], Coulomb [N m], viscous [N m s/rad] increments, (3, n).
        lowest_mass: lower bounds of the errors of the links' masses, in deviations of their prior [1], (n,).
        travel: range of each joint [rad], (n,).
        inertia: what a rotor's inertia is measured against [kg m^2], (n,).
    """

    gram: np.ndarray
    cross: np.ndarray
    products: np.ndarray
    rows: np.ndarray
    deviation: np.ndarray
    weight: float
    lowest: np.ndarray
    lowest_mass: np.ndarray
    travel: np.ndarray
    inertia: np.ndarray

    @property
    def nominal(self) -> np.ndarray:
        """Values of the columns that give the nominal arm's torque, (n, D): p_j once, and its friction."""
        out = np.zeros(self.gram.shape[1:3])
        out[:, self.shared] = 1.0
        out[:, self.shared + COULOMB] = -self.lowest[1]
        out[:, self.shared + VISCOUS] = -self.lowest[2]
        return out

    @property
    def shared(self) -> int:
        """Number of columns that all joints share, 10 n + 2; the joint's own follow."""
        return int(self.gram.shape[2]) - OWN

    def read(self, reading: Reading) -> MappedTorque:
        """The torque as a reading reads it."""
        torque = reading.torque
        source, factor = list(torque.source), np.array(torque.factor)
        joints = np.arange(len(source))
        gravity = len(joints) + joints
        # two index arrays with a slice between them: numpy puts their axis first
        by_joint = self.cross[:, joints, :, source]
        cross = by_joint.transpose(1, 0, 2) * factor[:, None]
        square = self.products[:, source, source] * factor**2
        pull = self.products[:, source, gravity] * factor
        if reading.gravity:
            own = self.products[:, gravity, gravity]
            cross = cross + self.cross[:, joints, :, gravity].transpose(1, 0, 2)
            square = square + 2 * pull + own
            pull = pull + own
        deviation = self.deviation[source] * np.abs(factor)
        return MappedTorque(cross, square, pull, deviation)


def fold_equations(
    arm: NominalArm, body: RigidBody, samples: FaultSamples, reading: Reading
) -> FoldEquations:
    """Normal equations of all folds under a reading of the motion and the torque's delay.

    Sources and factors of the torque, and whether gravity was left out of it, do not matter.
    """
    q, dq, ddq = reading.true_motion(samples.q, samples.dq, samples.ddq)
    regressor = body.regressor(q, dq, ddq)
    sign = np.tanh(dq / (FAULT_SIGN_WIDTH * arm.per_radian))
    nominal = regressor @ body.inertial_parameters() + arm.armature * ddq
    pull = body.gravity_regressor(q)
    gravity = pull @ body.gravity
    if samples.load.any():
        still = np.zeros_like(q)
        nominal += _load_torque(body, regressor, samples.load)
        gravity += _load_torque(body, body.regressor(q, still, still), samples.load)
    centred = q - q.mean(axis=0)
    own = np.stack([nominal, ddq, sign, dq, centred, np.ones_like(q)], axis=2)
    std = inertial_prior_std(body)
    level = pull @ _tilts(body)
    x = np.concatenate([regressor * std, level, own], axis=2).transpose(1, 0, 2)
    folds = samples.folds
    torques = np.concatenate([samples.torque(reading.recorded_delay), gravity], axis=1)
    return FoldEquations(
        gram=np.array([x[:, f].transpose(0, 2, 1) @ x[:, f] for f in folds]),
        cross=np.array([x[:, f].transpose(0, 2, 1) @ torques[f] for f in folds]),
        products=np.array([torques[f].T @ torques[f] for f in folds]),
        rows=np.array([f.stop - f.start for f in folds]),
        deviation=torque_deviation(samples.torque(reading.recorded_delay)),
        weight=samples.weight,
        lowest=-np.array([arm.armature, arm.coulomb, arm.viscous]),
        lowest_mass=-np.maximum(body.inertial_parameters()[::10], 0.0) / std[::10],
        travel=np.ptp(q, axis=0),
        inertia=_joint_inertia(arm, body),
    )


def _tilts(body: RigidBody) -> np.ndarray:
    """Changes of gravity by a base tilted by ``PRIOR_STD_TILT`` about either axis across it [m/s^2], (3, 2)."""
    gravity = body.gravity
    size = float(np.linalg.norm(gravity))
    if size == 0:
        return np.zeros((3, 2))
    across = np.linalg.svd(gravity[None] / size)[2][1:]
    return np.asarray(PRIOR_STD_TILT * size * across.T)


def _load_torque(
    body: RigidBody, regressor: np.ndarray, load: np.ndarray
) -> np.ndarray:
    """Torque of a known body on the last link [N m], (M, n), from the regressor of a motion."""
    last = regressor[:, :, 10 * body.last_link : 10 * body.last_link + 10]
    return np.einsum("mjp,mp->mj", last, load)


def inertial_prior_std(body: RigidBody) -> np.ndarray:
    """Prior standard deviations of inertial errors, (10 n,), in kg, kg m, kg m^2; the last link may carry a load."""
    std = PRIOR_STD_INERTIALS * inertial_scale(body).reshape(-1, 10)
    link_lengths = [
        float(np.linalg.norm(body.model.jointPlacements[int(link)].translation))
        for link in body.links
    ]
    mass = PRIOR_STD_LOAD * float(body.inertial_parameters()[::10].sum())
    lever = PRIOR_STD_LEVER * max(sum(link_lengths), 0.1)
    load = np.array([mass, *[mass * lever] * 3, *[mass * lever**2] * 6])
    std[body.last_link] = np.hypot(std[body.last_link], load)
    return np.maximum(std.ravel(), 1e-9)


def torque_deviation(tau: np.ndarray) -> np.ndarray:
    """Standard deviation of each recorded torque [N m], (n,), kept from zero."""
    deviation = tau.std(axis=0)
    return np.maximum(
        deviation, max(MIN_TORQUE_DEVIATION * float(deviation.max()), 1e-9)
    )


def _joint_inertia(arm: NominalArm, body: RigidBody) -> np.ndarray:
    """Inertia about each joint with the arm at zero, or its armature if that is more [kg m^2], (n,)."""
    inertia = np.diag(body.mass_matrix(np.zeros(body.n_joints)))
    least = 1e-3 * max(float(inertia.max()), 1e-3)
    return np.maximum(np.maximum(inertia, arm.armature), least)


# How much of the nominal arm's weight a torque carries, all joints together: an arm weighs about what its model says.
#
# Errors of single links are ordinary, but not that nothing has weight, or that the whole arm has a tenth of it. With
# what inertia, friction and an offset explain taken out of both, tau_j = b g_j, with one b for the arm [1].


def weight_penalty(eq: FoldEquations, torque: MappedTorque, spread: float) -> float:
    """Half the squared error of the arm's weight, ln b, in deviations of its prior [nats].

    0 for an arm that is as heavy as its model or more: a load may add any weight.

    Args:
        eq: normal equations under a reading.
        torque: the torque as the reading reads it.
        spread: factor on the deviation of the prior.
    """
    share, std = weight_share(eq, torque)
    # the logarithm of nothing, or of a weight that pulls upwards, is that of the least weight
    share = max(share, MIN_WEIGHT)
    lacking = max(-np.log(share), 0.0)
    return 0.5 * lacking**2 / ((spread * ORDINARY_WEIGHT) ** 2 + (std / share) ** 2)


def weight_share(eq: FoldEquations, torque: MappedTorque) -> tuple[float, float]:
    """b [1] and its standard deviation, which is infinite if no joint carries a weight that changes."""
    joints = np.arange(len(torque.deviation))
    gravity = len(joints) + joints
    # z = (p - g, sgn dq, dq, 1), p the nominal arm's torque
    columns = eq.shared + np.array([0, COULOMB, VISCOUS, OFFSET])
    square = eq.products.sum(axis=0)[gravity, gravity]
    # products of z with g, with itself, and with the torque
    by_gravity = eq.cross.sum(axis=0)[joints, :, gravity][:, columns]
    own = eq.gram.sum(axis=0)[:, columns[:, None], columns]
    own[:, 0] -= by_gravity
    own[:, :, 0] = own[:, 0]
    own[:, 0, 0] += square - by_gravity[:, 0]
    with_pull = by_gravity.copy()
    with_pull[:, 0] -= square
    with_torque = torque.cross.sum(axis=0)[:, columns]
    pull = torque.pull.sum(axis=0)
    with_torque[:, 0] -= pull

    inverse = np.linalg.pinv(own, hermitian=True)
    explained = np.einsum("jab,jb->ja", inverse, with_pull)
    carried = pull - (explained * with_torque).sum(axis=1)
    heavy = np.maximum(square - (explained * with_pull).sum(axis=1), 0.0)
    precision = 1.0 / torque.deviation**2
    total = float(precision @ heavy)
    if total <= 0.0:
        return 1.0, np.inf
    std = ORDINARY_GAP_DEVIATION / np.sqrt(eq.weight * total)
    return float(precision @ carried) / total, float(std)


# The ordinary values of an arm fitted under a reading: the gap on held-out folds, and the penalty on the values.


MAX_ROUNDS = 5
"""Times at most that values below their bounds are fixed there."""


def held_out_gap(
    eq: FoldEquations, reading: Reading, spread: float = 1.0
) -> tuple[np.ndarray, float]:
    """How well an ordinary arm explains the torque under a reading, and how extraordinary it must be for that.

    Args:
        eq: normal equations under the motion of the reading.
        reading: how to read the torque.
        spread: factor on the standard deviations of the prior.

    Returns:
        Gap left on each fold with values fitted to the other folds, over the torque's deviation, (K, n); and half the
        squared size of the values fitted to all folds, in deviations of their prior.
    """
    torque = eq.read(reading)
    target, square = _against_nominal(eq, torque)
    # cross-validation over the folds; the last fit is to all of them
    folds = len(eq.rows)
    others = np.vstack([1.0 - np.eye(folds), np.ones(folds)])
    values = _fit(eq, target, torque.deviation, spread, others)
    gap = _gap(eq, target, square, values[:folds]) / torque.deviation
    return gap, _penalty(eq, torque, values[folds], spread)


def joints_alone(eq: FoldEquations, reading: Reading, *, bodies: bool) -> np.ndarray:
    """Held-out gap of the nominal bodies as they are, or of none, beside free values of the joints alone, (K, n).

    Over the torque's deviation. Free are rotor, friction, spring and offset of each joint; neither inertials nor the
    torque's scale are.
    """
    torque = eq.read(reading)
    free = np.arange(eq.gram.shape[2]) > eq.shared
    target, square = _against_nominal(eq, torque, bodies=bodies)
    alone = replace(eq, gram=eq.gram * np.outer(free, free))
    values = _fit(alone, target * free, torque.deviation, 1.0, 1 - np.eye(len(eq.rows)))
    return _gap(eq, target, square, values) / torque.deviation


def fitted_gap(eq: FoldEquations, reading: Reading) -> tuple[np.ndarray, float]:
    """The same with the gap on each fold of the values fitted to all folds: smaller, at a fraction of the cost."""
    torque = eq.read(reading)
    target, square = _against_nominal(eq, torque)
    whole = np.ones((1, len(eq.rows)))
    values = _fit(eq, target, torque.deviation, 1.0, whole)
    gap = _gap(eq, target, square, values) / torque.deviation
    return gap, _penalty(eq, torque, values[0], 1.0)


def _gap(
    eq: FoldEquations, target: np.ndarray, square: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """RMS of what values, (K, n, D) or (1, n, D) for all, leave on each fold [N m], (K, n)."""
    explained = 2 * (values * target).sum(axis=2)
    fitted_square = (values * (eq.gram @ values[..., None])[..., 0]).sum(axis=2)
    squared_error = np.clip(square - explained + fitted_square, 0, None)
    return np.asarray(np.sqrt(squared_error / eq.rows[:, None]))


def _penalty(
    eq: FoldEquations, torque: MappedTorque, values: np.ndarray, spread: float
) -> float:
    """Half the squared size of values, (n, D), and of the arm's weight, in deviations of their prior."""
    inertial = values[0, : eq.shared]
    own = values[:, eq.shared :] / _own_prior_std(eq, torque.deviation)
    penalty = 0.5 * float((inertial**2).sum() + (own**2).sum()) / spread**2
    return penalty + weight_penalty(eq, torque, spread)


def _against_nominal(
    eq: FoldEquations, torque: MappedTorque, *, bodies: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """X_j^T (tau_j - f_j), (K, n, D), and the sum of (tau_j - f_j)^2, (K, n).

    f is the nominal arm's torque, friction included; without ``bodies`` its friction alone.
    """
    nominal = eq.nominal
    nominal[:, eq.shared] *= bodies
    predicted = np.einsum("kjde,je->kjd", eq.gram, nominal)
    square = (
        torque.square
        - 2 * np.einsum("kjd,jd->kj", torque.cross, nominal)
        + np.einsum("kjd,jd->kj", predicted, nominal)
    )
    return torque.cross - predicted, square


def _fit(
    eq: FoldEquations,
    target: np.ndarray,
    deviation: np.ndarray,
    spread: float,
    weights: np.ndarray,
) -> np.ndarray:
    """Most probable values of every joint's columns within their bounds, (F, n, D), of several fits at once.

    The unknowns are the inertial errors, once, and then the own values of each joint.

    Args:
        eq: normal equations of K folds.
        target: right sides, (K, n, D).
        deviation: of each joint's torque [N m], (n,).
        spread: factor on the standard deviations of the prior.
        weights: of the folds in each fit, (F, K).
    """
    n, shared, fits = target.shape[1], eq.shared, len(weights)
    right = np.tensordot(weights, target, 1) * _precision(eq, deviation)[:, None]
    matrix = _information(eq, deviation, weights)
    prior = 1.0 / (spread * _prior_std(eq, deviation)) ** 2
    matrix[:, np.arange(len(prior)), np.arange(len(prior))] += prior
    inertial_side = right[:, :, :shared].sum(axis=1)
    own_side = right[:, :, shared:].reshape(fits, -1)
    solved = bounded_minimum(matrix, np.hstack([inertial_side, own_side]), _lowest(eq))
    inertial = np.repeat(solved[:, None, :shared], n, axis=1)
    return np.concatenate([inertial, solved[:, shared:].reshape(fits, n, OWN)], axis=2)


def _precision(eq: FoldEquations, deviation: np.ndarray) -> np.ndarray:
    """What a squared error of a row counts [1/(N m)^2], (n,), given the deviation of each joint's torque [N m]."""
    return np.asarray(eq.weight / (ORDINARY_GAP_DEVIATION * deviation) ** 2)


def _information(
    eq: FoldEquations, deviation: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """What folds tell of all unknowns, (F, P, P), P = 10 n + 2 + 6 n; arguments as of ``_fit``."""
    n, shared = len(deviation), eq.shared
    gram = np.tensordot(weights, eq.gram, 1)
    gram = gram * _precision(eq, deviation)[:, None, None]
    # all joints share the inertial errors; their own values meet only through these
    size = shared + n * OWN
    matrix = np.zeros((len(weights), size, size))
    matrix[:, :shared, :shared] = gram[:, :, :shared, :shared].sum(axis=1)
    for j in range(n):
        own = slice(shared + j * OWN, shared + (j + 1) * OWN)
        coupling = gram[:, j, :shared, shared:]
        matrix[:, :shared, own] = coupling
        matrix[:, own, :shared] = coupling.transpose(0, 2, 1)
        matrix[:, own, own] = gram[:, j, shared:, shared:]
    return matrix


def _prior_std(eq: FoldEquations, deviation: np.ndarray) -> np.ndarray:
    """Prior standard deviations of all unknowns, (P,): inertial errors are in units of theirs."""
    own = _own_prior_std(eq, deviation)
    return np.concatenate([np.ones(eq.shared), own.ravel()])


def chance_of_values(eq: FoldEquations, reading: Reading, noise: np.ndarray) -> float:
    """Chance that an ordinary arm needs values as far from its model as this torque does, or farther [1].

    Over draws of the prior twice the penalty is a sum of squares of standard normal numbers, each times the share
    s / (1 + s) of what the data tell of a direction of the values, s being an eigenvalue of S A S with the information
    A and the prior's deviations S; and one for the arm's weight. Its distribution is taken as a scaled chi^2 of the
    same mean and variance [satterthwaite1946].

    Args:
        eq: normal equations under the motion of the reading.
        reading: how to read the torque.
        noise: gap of each joint over its torque's deviation that is no ordinary arm's [1], (n,).
    """
    torque = eq.read(reading)
    target, _ = _against_nominal(eq, torque)
    weight = (ORDINARY_GAP_DEVIATION / np.maximum(noise, ORDINARY_GAP_DEVIATION)) ** 2
    eq = replace(eq, gram=eq.gram * weight[:, None, None])
    deviation, whole = torque.deviation, np.ones((1, len(eq.rows)))
    values = _fit(eq, target * weight[:, None], deviation, 1.0, whole)[0]
    std = _prior_std(eq, deviation)
    told = _information(eq, deviation, whole)[0]
    size = np.maximum(np.linalg.eigvalsh(std[:, None] * told * std), 0.0)
    share = np.append(size / (1.0 + size), 1.0)
    scale = (share**2).sum() / share.sum()
    penalty = _penalty(eq, torque, values, 1.0)
    return float(chi2.sf(2 * penalty / scale, share.sum() / scale))


def _lowest(eq: FoldEquations) -> np.ndarray:
    """Lower bounds of the unknowns: the inertial errors, then each joint's own values."""
    n = eq.gram.shape[1]
    # scale, rotor, Coulomb and viscous friction have lower bounds; spring and offset have none
    own = np.full((n, OWN), -np.inf)
    own[:, 0] = LOWEST_TORQUE_SCALE
    own[:, 1:4] = eq.lowest.T
    # and no link weighs less than nothing
    shared = np.full(eq.shared, -np.inf)
    shared[: 10 * n : 10] = eq.lowest_mass
    return np.concatenate([shared, own.ravel()])


def _own_prior_std(eq: FoldEquations, deviation: np.ndarray) -> np.ndarray:
    """Prior standard deviations of each joint's own values, (n, 6)."""
    speed, acceleration = (
        np.sqrt(eq.gram[:, :, column, column].sum(axis=0) / eq.rows.sum())
        for column in (eq.shared + VISCOUS, eq.shared + ROTOR)
    )
    coulomb, viscous = -eq.lowest[1:]
    # behind a high gear a rotor takes most of the torque, however light the links are
    rotor = PRIOR_STD_ROTOR * deviation / np.maximum(acceleration, 1e-3)
    return np.column_stack(
        [
            np.full(len(deviation), PRIOR_STD_TORQUE_SCALE),
            np.hypot(rotor, eq.inertia),
            # nominal friction may be a placeholder: an arm without any of it is ordinary
            np.hypot(PRIOR_STD_FRICTION * deviation, coulomb),
            np.hypot(PRIOR_STD_FRICTION * deviation / np.maximum(speed, 1e-3), viscous),
            PRIOR_STD_SPRING * deviation / np.maximum(eq.travel, 1e-2),
            PRIOR_STD_OFFSET * deviation,
        ]
    )


def bounded_minimum(a: np.ndarray, b: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """Minima of x^T A x / 2 - b^T x for x >= lowest, by fixing what falls below, at most ``MAX_ROUNDS`` times; (F, P).

    A value that was fixed is not freed again, so that the result may lie beside the exact optimum
    (``scipy.optimize.lsq_linear``): it is eight times as fast and called some hundred times per case.

    Args:
        a: A of each problem, (F, P, P).
        b: of each problem, (F, P).
        lowest: of all, (P,).
    """
    fixed = np.zeros(b.shape, dtype=bool)
    bound = np.where(np.isfinite(lowest), lowest, 0.0)
    diagonal = np.arange(b.shape[1])
    for _ in range(MAX_ROUNDS):
        held = fixed * bound
        right_side = b - (a @ held[..., None])[..., 0]
        # the equation of a value that is fixed says so
        reduced = np.where(fixed[:, :, None] | fixed[:, None, :], 0.0, a)
        reduced[:, diagonal, diagonal] += fixed
        free = np.linalg.solve(reduced, np.where(fixed, 0.0, right_side)[..., None])
        x = held + free[..., 0]
        below = x < lowest - 1e-12
        if not below.any():
            break
        fixed |= below
    return np.maximum(x, lowest)


# Readings of a case compared: how well each lets an ordinary arm explain torque that was not used to fit.
#
# The gain of a reading is the sum over joints of log(R without / R with), R = sqrt(gap^2 + ORDINARY_GAP^2) with the
# held-out gap over the torque's deviation, and of log(P without / P with), P = penalty + ORDINARY_PENALTY with the
# prior's penalty on the values that the arm would have to have. The floors keep small effects from counting: a setup
# fault is gross.
#
# That is the evidence of the columns as they were recorded. Of a column x read as k x, N samples have the density
# p(x) = |k|^N p(k x), Jacobian included: its logarithm is N log |k| - N log RMS(k x - prediction), up to a constant.
# The deviation of the torque read is |k| times that of x, so that a gap over it holds the Jacobian, and a torque
# divided by a thousand is not explained any better. Motions, on which the prediction rests, are given: none is due to
# them.


KEPT_EQUATIONS = 8
"""Motions beyond the present one of which equations are kept."""


@dataclass(frozen=True)
class ReadingScore:
    """How a reading did.

    Attributes:
        residual: sqrt(gap^2 + ORDINARY_GAP^2) of each fold and joint, (K, n).
        penalty: of the prior on the values fitted to all folds, plus ``ORDINARY_PENALTY``.
    """

    residual: np.ndarray
    penalty: float

    @property
    def joint_rms(self) -> np.ndarray:
        """Root mean square of the residual over the folds, (n,)."""
        return np.sqrt((self.residual**2).mean(axis=0))

    def joint_gain(self, before: ReadingScore) -> np.ndarray:
        """Gain of each joint over another reading, (n,)."""
        return np.log(before.joint_rms / self.joint_rms)

    def fold_gain(self, before: ReadingScore) -> np.ndarray:
        """Gain of each fold, summed over joints, (K,)."""
        return np.log(before.residual / self.residual).sum(axis=1)

    def penalty_gain(self, before: ReadingScore) -> float:
        """Gain by a smaller penalty."""
        return float(np.log(before.penalty / self.penalty))

    def gain(self, before: ReadingScore) -> float:
        """Gain in all."""
        return float(self.joint_gain(before).sum()) + self.penalty_gain(before)


@dataclass
class ReadingScorer:
    """Scores readings of one case on its samples; equations of the last few motions are kept.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
    """

    arm: NominalArm
    body: RigidBody
    samples: FaultSamples
    _equations: dict[tuple[object, ...], FoldEquations] = field(default_factory=dict)
    _bodies: dict[tuple[object, ...], RigidBody | None] = field(default_factory=dict)

    def score(self, reading: Reading, spread: float = 1.0) -> ReadingScore:
        """Score of a reading; the worst possible for an arm that cannot be.

        Args:
            reading: how to read the recordings.
            spread: factor on what the arm may ordinarily have beyond its data sheet.
        """
        eq = self.equations_of(reading)
        if eq is None:
            return self._worst()
        return _scored(*held_out_gap(eq, reading, spread))

    def is_of_another_arm(self, reading: Reading, *, far_off: bool) -> bool:
        """Whether no ordinary arm of these bodies made the torque.

        The values that it would need are no draw of their prior: all that it leaves unexplained counts as noise then,
        unless the nominal arm is far off. Or the bodies as they are predict held-out torque worse than no bodies at
        all, friction of the joints free, and fitted ones predict it better, or the nominal arm is far off.

        Args:
            reading: how to read the recordings.
            far_off: whether the nominal arm's torque is off by more than that of no arm.
        """
        eq = self.equations_of(reading)
        if eq is None:
            return True
        ordinary = self.score(reading)
        left = ordinary.joint_rms * (not far_off)
        if chance_of_values(eq, reading, left) < FAULT_PRIOR_ODDS:
            return True
        without, nominal = (
            _scored(joints_alone(eq, reading, bodies=bodies), 0.0)
            for bodies in (False, True)
        )
        shown = far_off or ordinary.joint_gain(without).sum() > FAULT_GAIN
        return bool(shown and nominal.joint_gain(without).sum() < 0)

    def best_score(self, reading: Reading) -> ReadingScore:
        """What a reading scores at most: as if no fold had been held out. A quarter of the cost of ``score``."""
        eq = self.equations_of(reading)
        if eq is None:
            return self._worst()
        return _scored(*fitted_gap(eq, reading))

    def _worst(self) -> ReadingScore:
        """Score of an arm that cannot be."""
        shape = (len(self.samples.folds), self.arm.n_joints)
        return ReadingScore(np.full(shape, WORST_GAP), WORST_GAP)

    def gravity_turn(self, reading: Reading) -> tuple[float, float] | None:
        """Roll and pitch [rad] of the base that the torque shows under a reading which does not turn it yet."""
        body = self._body(reading)
        if body is None or not body.gravity.any() or reading.gravity:
            return None
        q, dq, ddq = reading.true_motion(
            self.samples.q, self.samples.dq, self.samples.ddq
        )
        tau = reading.torque(self.samples.torque(reading.recorded_delay))
        regressor = body.gravity_regressor(q)
        needed = body.inverse_dynamics(q, dq, ddq) + self.arm.armature * ddq
        without_gravity = tau - needed + regressor @ body.gravity
        found = gravity_by_torque(without_gravity, regressor, dq, torque_deviation(tau))
        return turn_of_base(body.gravity, found)

    def equations_of(self, reading: Reading) -> FoldEquations | None:
        """Equations under a reading; ``None`` if its inertials leave no arm."""
        key = reading.equation_key
        if key not in self._equations:
            body = self._body(reading)
            if body is None:
                return None
            if len(self._equations) > KEPT_EQUATIONS:
                oldest = next(iter(self._equations))
                del self._equations[oldest]
            self._equations[key] = fold_equations(self.arm, body, self.samples, reading)
        return self._equations[key]

    def _body(self, reading: Reading) -> RigidBody | None:
        """Dynamics with the inertials moved and the base turned; ``None`` if a joint is then without a body."""
        key = (reading.link_shift, reading.moved_only, reading.turn)
        if key not in self._bodies:
            try:
                shifted = shifted_body(self.arm, reading.link_shift, reading.moved_only)
                body = self.body if shifted is None else shifted
                if any(reading.turn):
                    gravity = tilt(*reading.turn).T @ body.gravity
                    body = body.changed(np.zeros((self.arm.n_joints, 10)), gravity)
                self._bodies[key] = body
            except InputError:
                self._bodies[key] = None
        return self._bodies[key]


def _scored(gap: np.ndarray, penalty: float) -> ReadingScore:
    """Score of a gap over the torque's deviation, (K, n), and a penalty, kept finite."""
    finite_gap = np.nan_to_num(gap, nan=WORST_GAP, posinf=WORST_GAP)
    finite_penalty = float(np.nan_to_num(penalty, nan=WORST_GAP, posinf=WORST_GAP))
    return ReadingScore(
        np.hypot(np.minimum(finite_gap, WORST_GAP), ORDINARY_GAP),
        ORDINARY_PENALTY + finite_penalty,
    )
