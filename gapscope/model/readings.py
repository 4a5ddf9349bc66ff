"""How probable a reading of recordings is: the evidence of their torque for an ordinary arm of the data sheet.

The torque of joint j, as it is read, is taken as

    tau_j = p_j + f_j + Y_j delta + G_j theta
          + k_j p_j + a_j ddq_j + c_j sgn dq_j + b_j dq_j + s_j q_j + o_j + l_j sgn(dq_j - T ddq_j) + e_j

with p the torque of the nominal arm's bodies and rotors, known payload included, f its friction, Y the inertial
regressor and delta errors of the inertials, a load on the last link among them, G the regressor of gravity and theta
the change of gravity by a tilted base, common to all joints, and e what an arm leaves, of unknown size. All values have
a normal prior around zero, which physics cuts off, and are integrated over: a reading that asks for an extraordinary
arm is improbable, and one that is right only because values were fitted gains nothing.

Of a column x read as k x, N samples have the density |k|^N p(k x), Jacobian included. The deviation of what is read is
|k| times that of x: what is left counts over it, and a torque divided by a thousand is not explained any better.
Motions, on which the prediction rests, are given: none is due to them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.arm.reading import Reading
from gapscope.arm.recording import STILL
from gapscope.arm.robots import shifted_arm
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.effects.environment import tilt
from gapscope.effects.setup_faults import LateTorque
from gapscope.model.conditioning import MIN_FLOOR, TORQUE_CUTOFF, Segment, low_pass
from gapscope.model.effective_samples import motion_samples

FAULT_SAMPLES = 640
"""Samples over all recordings; faults are gross, so that few suffice. (budget)"""
MOTION_INDEPENDENT_RATE = 3.0
"""Independent samples per second of an arm's motion [1/s]. (hand)"""
FAULT_PRIOR_ODDS = 1e-3
"""Prior odds of a fault of one kind against none, of another robot, and of a base mounted turned [1]. (hand)"""
UNUSUAL = -math.log(FAULT_PRIOR_ODDS)
"""Evidence that a fault needs to be as probable as none [nats]."""
TORQUE_SHIFT_STEP = 0.005
"""Step of the shifts at which the recorded torque is kept, up to the longest delay of a driver [s]. (budget)"""
LAST_SHIFT = round(LateTorque.parameters[0].bounds[1] / TORQUE_SHIFT_STEP)
TORQUE_SHIFTS = tuple(TORQUE_SHIFT_STEP * k for k in range(LAST_SHIFT + 1))

# What an ordinary arm may have beyond its data sheet (standard deviations at most).

ORDINARY_GAP = 0.1
"""What an arm leaves in any case, over the torque's deviation [1]: complete models of real arms leave 0.04 to 0.23.
(physical)"""
ORDINARY_ERROR = 0.3
"""Errors of the nominal inertials and of a torque's scale, and the lever of a load in lengths of the arm [1].
(physical)"""
LOWEST_TORQUE_SCALE = -2 * ORDINARY_ERROR
"""Lower bound of that of the scale: two deviations [1]. (statistics)"""
PRIOR_STD_TILT = 0.1
"""Tilt of the base [rad]. (hand)"""
PRIOR_STD_LOAD = 0.6
"""Mass of a load, in masses of the arm [1]. (hand)"""
ORDINARY_TORQUE = 0.7
"""Torque of a rotor, of friction, of a spring, of an offset, over the deviation of the joint's torque [1]. (hand)"""
ROTOR_RATIO = 30.0
"""Inertia of a rotor at the joint, over that of the bodies about it, at most [1]. (physical)"""
TURNING_LATE = 0.05
"""T, by which dry friction may turn round late: bristles bend first [s]. (hand)"""
MIN_TORQUE_DEVIATION = 1e-4
"""Least deviation of a torque, over the largest joint's [1]: motors of small joints. (physical)"""

# What is looked at: few samples of each recording, spread over its length.


@dataclass(frozen=True)
class FaultSamples:
    """Samples of a case, M in all, of n joints.

    Attributes:
        q, dq, ddq: recorded motion [rad], [rad/s], [rad/s^2], shape (M, n).
        later_tau: recorded torque after the 12 Hz filter [N m], at the time of the sample plus each of
            ``TORQUE_SHIFTS``, (S, M, n).
        independent: samples among them that are independent [1].
        load: inertial parameters of the known body on the last link, (M, 10); zeros if there was none.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    later_tau: np.ndarray
    independent: float
    load: np.ndarray

    def torque(self, delay: float | np.ndarray = 0.0) -> np.ndarray:
        """Recorded torque [N m] at the time of the samples plus a delay [s], of all joints or (n,); (M, n)."""
        last = len(self.later_tau) - 1
        joints = np.arange(self.q.shape[1])
        # on a straight line between the shifts that were kept
        place = np.broadcast_to(
            np.minimum(delay / TORQUE_SHIFT_STEP, last), (len(joints),)
        )
        before = place.astype(int)
        share = place - before
        after = np.minimum(before + 1, last)
        rows = np.arange(len(self.q))[:, None]
        early, late = (self.later_tau[k, rows, joints] for k in (before, after))
        return np.asarray((1 - share) * early + share * late)

    def thinned(self, step: int) -> FaultSamples:
        """Every ``step``-th sample."""
        kept = slice(step // 2, None, step)
        q, dq, ddq = self.q[kept], self.dq[kept], self.ddq[kept]
        independent = min(self.independent, float(len(q)))
        return FaultSamples(
            q, dq, ddq, self.later_tau[:, kept], independent, self.load[kept]
        )


def sample(segments: Sequence[Segment]) -> FaultSamples:
    """Samples of segments with a torque."""
    counts = [len(s.motion.t[s.inner]) for s in segments]
    seconds = sum(n / s.motion.rate for n, s in zip(counts, segments, strict=True))
    step = max(1, math.ceil(sum(counts) / FAULT_SAMPLES))
    parts = [_of_segment(s, step) for s in segments]
    motion, later_tau, load = (
        np.concatenate(part, axis=axis)
        for part, axis in zip(zip(*parts, strict=True), (1, 1, 0), strict=True)
    )
    # as many as the motion has, and no more than were taken
    independent = motion_samples(seconds, MOTION_INDEPENDENT_RATE)
    q, dq, ddq = motion
    return FaultSamples(q, dq, ddq, later_tau, min(independent, float(len(q))), load)


def _of_segment(segment: Segment, step: int) -> tuple[np.ndarray, ...]:
    """Motion, (3, M, n), torque at the times of its rows plus ``TORQUE_SHIFTS``, (S, M, n), and load, (M, 10).

    What is trimmed from the end of a segment is longer than the largest shift.
    """
    assert segment.torque is not None
    motion, kept = segment.motion, slice(step // 2, None, step)
    # in the same band: what noise adds to accelerations is in no torque
    *moved, torque = (
        low_pass(x, motion.rate, TORQUE_CUTOFF)
        for x in (motion.q, motion.dq, motion.ddq, segment.torque)
    )
    tau = make_interp_spline(motion.t, torque, k=3)
    t = motion.t[segment.inner][kept]
    later = np.stack([tau(t + shift) for shift in TORQUE_SHIFTS])
    load = np.zeros(10) if segment.payload is None else segment.payload.parameters
    inner = np.stack(moved)[:, segment.inner][:, kept]
    return inner, later, np.tile(load, (len(t), 1))


# The sums that all readings of the torque share.

OF_JOINT = ("scale", "rotor", "coulomb", "viscous", "spring", "offset", "turning")
"""Values of each joint of its own; the last one is friction that turns round late."""
OWN = len(OF_JOINT)
"""Number of them."""
ROTOR, COULOMB, VISCOUS, OFFSET = map(
    OF_JOINT.index, ("rotor", "coulomb", "viscous", "offset")
)
"""Places of the rotor, the friction coefficients and the offset among them."""


@dataclass(frozen=True)
class MappedTorque:
    """The torque as a reading reads it, against the columns of ``ReadingEquations``; n joints.

    Attributes:
        cross: X_j^T tau_j, (n, D).
        square: tau_j^2 summed, (n,).
        deviation: standard deviation of each joint's torque [N m], (n,); of the recorded one, whether gravity was left
            out of it or not: what is left with and without it compares as it is.
    """

    cross: np.ndarray
    square: np.ndarray
    deviation: np.ndarray


@dataclass(frozen=True)
class ReadingEquations:
    """Normal equations of each joint under one reading of the motion, n joints.

    X_j = [Y_j, G_j, p_j, ddq_j, sgn dq_j, dq_j, q_j, 1, sgn(dq_j - T ddq_j)] has D = 10 n + 9 columns: those of the
    inertial errors and of the base's tilt, in units of their size, which all joints share, and those of the joint's own
    values.

    Attributes:
        gram: X^T X, (n, D, D).
        cross: X^T b for every torque b, the recorded columns and then each joint's gravity torque, (n, D, 2 n).
        products: b_i b_k summed over the samples of each joint, (n, 2 n, 2 n).
        rows, independent: number of samples that count on each joint, and of independent ones among them, (n,).
        deviation: standard deviation of each recorded torque column [N m], (n,).
        bodies, load: prior deviations of inertials that are off by their own size, and of a load, (10 n,), in the
            columns' units.
        lowest: lower bounds of rotor [kg m^2], Coulomb [N m], viscous [N m s/rad] increments, (3, n).
        lowest_mass: lower bounds of the errors of the links' masses, in the columns' units, (n,).
        travel: range of each joint [rad], (n,).
        inertia: what a rotor's inertia is measured against [kg m^2], (n,).
    """

    gram: np.ndarray
    cross: np.ndarray
    products: np.ndarray
    rows: np.ndarray
    independent: np.ndarray
    deviation: np.ndarray
    bodies: np.ndarray
    load: np.ndarray
    lowest: np.ndarray
    lowest_mass: np.ndarray
    travel: np.ndarray
    inertia: np.ndarray

    @property
    def shared(self) -> int:
        """Number of columns that all joints share, 10 n + 2; the joint's own follow."""
        return int(self.gram.shape[1]) - OWN

    def nominal(self, bodies: bool = True) -> np.ndarray:
        """Values of the columns that give the nominal arm's torque, (n, D): p_j once, and its friction."""
        out = np.zeros(self.gram.shape[:2])
        out[:, self.shared] = float(bodies)
        out[:, self.shared + COULOMB] = -self.lowest[1]
        out[:, self.shared + VISCOUS] = -self.lowest[2]
        return out

    def read(self, reading: Reading) -> MappedTorque:
        """The torque as a reading reads it."""
        torque = reading.torque
        source, factor = list(torque.source), np.array(torque.factor)
        joints = np.arange(len(source))
        # in cross and products the gravity torques follow the recorded columns
        gravity = len(joints) + joints
        cross = self.cross[joints, :, source] * factor[:, None]
        square = self.products[joints, source, source] * factor**2
        # gravity is put back: (k tau + g)^2 = k^2 tau^2 + 2 k tau g + g^2
        if reading.gravity:
            cross = cross + self.cross[joints, :, gravity]
            pull = self.products[joints, source, gravity] * factor
            square = square + 2 * pull + self.products[joints, gravity, gravity]
        return MappedTorque(cross, square, self.deviation[source] * np.abs(factor))


def reading_equations(
    arm: NominalArm,
    body: RigidBody,
    samples: FaultSamples,
    reading: Reading,
    delay: np.ndarray | None = None,
) -> ReadingEquations:
    """Normal equations under a reading of the motion and the torque's delay.

    Sources and factors of the torque, and whether gravity was left out of it, do not matter. While dry friction holds
    a joint its torque may be any: such samples do not count on it.

    Args:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
        reading: how to read it.
        delay: of each joint's column, (n,) [s], in place of the reading's, which is one for all.
    """
    q, dq, ddq = reading.true_motion(samples.q, samples.dq, samples.ddq)
    regressor = body.regressor(q, dq, ddq)
    sign = smooth_sign(dq / arm.per_radian)
    nominal = regressor @ body.inertial_parameters() + arm.armature * ddq
    pull = body.gravity_regressor(q)
    gravity = pull @ body.gravity
    if samples.load.any():
        still = np.zeros_like(q)
        nominal += _load_torque(body, regressor, samples.load)
        gravity += _load_torque(body, body.regressor(q, still, still), samples.load)
    # springs pull about the mean position; the offset is a column of its own
    centred = q - q.mean(axis=0)
    # of the same rows, however fast they are said to be
    late = TURNING_LATE * reading.time_factor
    turned = smooth_sign((dq - late * ddq) / arm.per_radian)
    own = np.stack([nominal, ddq, sign, dq, centred, np.ones_like(q), turned], axis=2)
    bodies, load = inertial_scale(body), _load_std(body)
    # columns in units of what each may be off by: the sums are better conditioned
    unit = np.maximum(np.hypot(bodies, load), SMALLEST)
    level = pull @ _tilts(body)
    # joints first: X_j is (M, D)
    x = np.concatenate([regressor * unit, level, own], axis=2).transpose(1, 0, 2)
    recorded = samples.torque(reading.recorded_delay if delay is None else delay)
    # by the speed that was recorded: the same samples count, however fast a reading says they are
    source = list(reading.motion.source)
    moves = np.ptp(samples.q[:, source], axis=0) >= STILL * arm.per_radian
    speed = samples.dq[:, source] / arm.per_radian
    slides = (np.abs(smooth_sign(speed)) * moves).T[:, :, None]
    x = x * slides
    torques = np.concatenate([recorded, gravity], axis=1) * slides
    rows = np.maximum((slides**2).sum(axis=(1, 2)), np.finfo(float).eps)
    return ReadingEquations(
        gram=x.transpose(0, 2, 1) @ x,
        cross=x.transpose(0, 2, 1) @ torques,
        products=torques.transpose(0, 2, 1) @ torques,
        rows=rows,
        independent=samples.independent * rows / len(q),
        deviation=torque_deviation(recorded),
        bodies=bodies / unit,
        load=load / unit,
        lowest=-np.array([arm.armature, arm.coulomb, arm.viscous]),
        lowest_mass=-np.maximum(body.inertial_parameters()[::10], 0.0) / unit[::10],
        travel=np.ptp(q, axis=0),
        inertia=_joint_inertia(arm, body),
    )


def _tilts(body: RigidBody) -> np.ndarray:
    """Changes of gravity by a base tilted by ``PRIOR_STD_TILT`` about either axis across it [m/s^2], (3, 2)."""
    gravity = body.gravity
    size = float(np.linalg.norm(gravity))
    if size == 0:
        return np.zeros((3, 2))
    # the right singular vectors but the first are across gravity
    across = np.linalg.svd(gravity[None] / size)[2][1:]
    return np.asarray(PRIOR_STD_TILT * size * across.T)


def _load_torque(
    body: RigidBody, regressor: np.ndarray, load: np.ndarray
) -> np.ndarray:
    """Torque of a known body on the last link [N m], (M, n), from the regressor of a motion."""
    last = regressor[:, :, 10 * body.last_link : 10 * body.last_link + 10]
    return np.einsum("mjp,mp->mj", last, load)


def _load_std(body: RigidBody) -> np.ndarray:
    """Prior standard deviations of a load on the last link, (10 n,), in kg, kg m, kg m^2."""
    link_lengths = [
        float(np.linalg.norm(body.model.jointPlacements[int(link)].translation))
        for link in body.links
    ]
    mass = PRIOR_STD_LOAD * float(body.inertial_parameters()[::10].sum())
    lever = ORDINARY_ERROR * max(sum(link_lengths), 0.1)
    std = np.zeros((body.n_joints, 10))
    # mass, three first moments, six second moments
    std[body.last_link] = [mass, *[mass * lever] * 3, *[mass * lever**2] * 6]
    return std.ravel()


def ordinary_errors(body: RigidBody) -> np.ndarray:
    """Deviations of the inertials of an arm with a bad data sheet and a load, (10 n,), in kg, kg m, kg m^2."""
    return np.hypot(ORDINARY_ERROR * inertial_scale(body), _load_std(body))


def torque_deviation(tau: np.ndarray) -> np.ndarray:
    """Standard deviation of each recorded torque [N m], (n,), kept from zero."""
    deviation = tau.std(axis=0)
    return np.maximum(
        deviation, max(MIN_TORQUE_DEVIATION * float(deviation.max()), MIN_FLOOR)
    )


def _joint_inertia(arm: NominalArm, body: RigidBody) -> np.ndarray:
    """Inertia about each joint with the arm at zero, or its armature if that is more [kg m^2], (n,)."""
    inertia = np.diag(body.mass_matrix(np.zeros(body.n_joints)))
    least = 1e-3 * max(float(inertia.max()), 1e-3)
    return np.maximum(np.maximum(inertia, arm.armature), least)


# The evidence of a reading.

ROUNDS = 4
"""Times that sizes of what is left, and of what an arm has beyond its data sheet, are estimated. (budget)"""
LEAST_SIZE = 0.01
"""Least size of what an arm has beyond its data sheet, over the largest [1]: as good as none. (numerical)"""


def evidence(eq: ReadingEquations, reading: Reading) -> float:
    """Logarithm of the probability of the torque under a reading, but for a constant of the columns [nats].

    At the likeliest sizes of what an arm has beyond its data sheet, no larger than an ordinary arm's, of errors of each
    link's inertials, tilt, and each value of a joint, and of what is left.
    """
    return _evidence(eq, reading, np.hypot(ORDINARY_ERROR * eq.bodies, eq.load))


def _evidence(
    eq: ReadingEquations, reading: Reading, errors: np.ndarray, *, bodies: bool = True
) -> float:
    """Log evidence [nats], given the largest deviations of the inertials in the columns' units, (10 n,).

    About the values of greatest probability within their bounds (Laplace); sizes by [mackay1992b]. Without ``bodies``
    there are those of the errors alone.
    """
    torque = eq.read(reading)
    nominal = eq.nominal(bodies)
    predicted = (eq.gram @ nominal[..., None])[..., 0]
    # |tau - X b|^2 = tau^2 - (2 X^T tau - X^T X b) b
    missing = torque.square - ((2 * torque.cross - predicted) * nominal).sum(axis=1)
    # all over the deviation of the torque read, per sample, and values over their largest deviations
    unit = eq.rows * torque.deviation**2
    largest = _largest(eq, torque, errors)
    missing = missing / unit
    target = (torque.cross - predicted) / unit[:, None] * largest
    gram = eq.gram / unit[:, None, None] * largest[:, :, None] * largest[:, None]
    # as declared: the column of the scale is made of these in each round
    nominal_gram, first = gram.copy(), target.copy()
    lowest, group = _lowest(eq, largest), _groups(eq)
    size, scale = np.ones(len(group)), eq.shared
    moved = np.eye(gram.shape[2])[scale]
    # no more than all of it, and no less than an arm leaves in any case
    left = np.minimum(np.maximum(missing, 0.0), 1.0)
    for _ in range(ROUNDS):
        noise = left + ORDINARY_GAP**2
        weight = eq.independent / noise
        # a joint's scale is that of a load as well: its column is the torque of the bodies as they were found
        target[:, scale] = first @ moved
        column = nominal_gram @ moved
        gram[:, :, scale] = gram[:, scale] = column
        gram[:, scale, scale] = column @ moved
        information = _information(eq, gram * weight[:, None, None])
        information[np.diag_indices_from(information)] += size**-2
        covariance = np.linalg.inv(information)
        weighted = target * weight[:, None]
        own_side = weighted[:, scale:].ravel()
        right = np.concatenate([weighted[:, :scale].sum(axis=0), own_side])
        found = bounded_minimum(information, right, lowest, covariance @ right)
        # shared values are the same on every joint, its own follow
        shared = np.tile(found[:scale], (len(gram), 1))
        values = np.hstack([shared, found[scale:].reshape(-1, OWN)])
        explained = 2 * target - (gram @ values[..., None])[..., 0]
        left = np.maximum(missing - (explained * values).sum(axis=1), 0.0)
        moved[:scale] = ORDINARY_ERROR * found[:scale]
        before = size
        # how far each value is told by the data: 1 - posterior over prior variance
        told = 1.0 - np.diag(covariance) / size**2
        square = np.bincount(group, found**2) / np.bincount(
            group, np.maximum(told, np.finfo(float).eps)
        )
        size = np.sqrt(np.clip(square, LEAST_SIZE**2, 1.0))[group]
    fit = np.log(noise) + (left + ORDINARY_GAP**2) / noise
    # over the sizes with which the information was summed, not those after it
    spread = np.linalg.slogdet(information * np.outer(before, before))[1]
    return -0.5 * float(eq.independent @ fit + spread + ((found / before) ** 2).sum())


def _groups(eq: ReadingEquations) -> np.ndarray:
    """Number of the size that each unknown has, (P,): of a link's inertials, of the tilt, and its own."""
    # ten parameters of each link, then the two angles of the tilt
    n = len(eq.deviation)
    shared = np.repeat(np.arange(n + 1), [*[10] * n, 2])
    return np.concatenate([shared, n + 1 + np.arange(n * OWN)])


def _information(eq: ReadingEquations, gram: np.ndarray) -> np.ndarray:
    """What the torque tells of all unknowns, (P, P), P = 17 n + 2, from what it tells of each joint's columns.

    All joints share the inertial errors and the tilt; their own values meet only through these.
    """
    shared = eq.shared
    size = shared + len(gram) * OWN
    out = np.zeros((size, size))
    out[:shared, :shared] = gram[:, :shared, :shared].sum(axis=0)
    for j, of_joint in enumerate(gram):
        own = slice(shared + j * OWN, shared + (j + 1) * OWN)
        out[:shared, own] = of_joint[:shared, shared:]
        out[own, :shared] = of_joint[shared:, :shared]
        out[own, own] = of_joint[shared:, shared:]
    return out


def _lowest(eq: ReadingEquations, largest: np.ndarray) -> np.ndarray:
    """Lower bounds of the unknowns over their largest deviations, (P,): the shared ones, then each joint's own."""
    # scale, rotor, Coulomb and viscous friction have lower bounds; spring and offset have none
    own = np.full((len(largest), OWN), -np.inf)
    own[:, 0] = LOWEST_TORQUE_SCALE
    own[:, 1:4] = eq.lowest.T
    # and no link weighs less than nothing
    shared = np.full(eq.shared, -np.inf)
    shared[: len(eq.load) : 10] = eq.lowest_mass
    below = np.concatenate([shared, own.ravel()])
    return below / np.concatenate(
        [largest[0, : eq.shared], largest[:, eq.shared :].ravel()]
    )


def _largest(
    eq: ReadingEquations, torque: MappedTorque, errors: np.ndarray
) -> np.ndarray:
    """Largest deviations of the columns' values of an ordinary arm, (n, D).

    Args:
        eq: normal equations under the reading.
        torque: as it is read.
        errors: of the inertials, in the columns' units, (10 n,).
    """
    deviation, n = torque.deviation, len(torque.deviation)
    speed, acceleration = (
        np.sqrt(eq.gram[:, column, column] / eq.rows)
        for column in (eq.shared + VISCOUS, eq.shared + ROTOR)
    )
    coulomb, viscous = -eq.lowest[1:]
    # behind a high gear a rotor takes most of the torque, however light the links are
    rotor = ORDINARY_TORQUE * deviation / np.maximum(acceleration, 1e-3)
    own = [
        np.full(n, ORDINARY_ERROR),
        np.hypot(np.minimum(rotor, ROTOR_RATIO * eq.inertia), eq.inertia),
        # nominal friction may be a placeholder: an arm without any of it is ordinary
        np.hypot(ORDINARY_TORQUE * deviation, coulomb),
        np.hypot(ORDINARY_TORQUE * deviation / np.maximum(speed, 1e-3), viscous),
        ORDINARY_TORQUE * deviation / np.maximum(eq.travel, 1e-2),
        # of the torque and not of what it varies by: a constant tells nothing of bodies
        ORDINARY_TORQUE * np.maximum(np.sqrt(torque.square / eq.rows), deviation),
        ORDINARY_TORQUE * deviation,
    ]
    others = np.ones(eq.shared - len(errors))
    shared = np.concatenate([np.maximum(errors, SMALLEST), others])
    return np.hstack([np.tile(shared, (n, 1)), np.column_stack(own)])


MAX_ROUNDS = 5
"""Times at most that values below their bounds are fixed there."""


def bounded_minimum(
    a: np.ndarray, b: np.ndarray, lowest: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """Minimum of x^T A x / 2 - b^T x for x >= lowest, by fixing what falls below, at most ``MAX_ROUNDS`` times; (P,).

    A value that was fixed is not freed again, so that the result may lie beside the exact optimum
    (``scipy.optimize.lsq_linear``): it is eight times as fast and called some thousand times per case.

    Args:
        a: A, (P, P).
        b: (P,).
        lowest: (P,).
        x: the minimum without bounds, (P,).
    """
    fixed = np.zeros(len(b), dtype=bool)
    for _ in range(MAX_ROUNDS):
        below = x < lowest - 1e-12
        if not below.any():
            break
        fixed |= below
        free = ~fixed
        x = np.where(fixed, lowest, 0.0)
        held = a[np.ix_(free, fixed)] @ lowest[fixed]
        x[free] = np.linalg.solve(a[np.ix_(free, free)], b[free] - held)
    return np.maximum(x, lowest)


# Readings of a case compared.

KEPT_EQUATIONS = 8
"""Motions beyond the present one of which equations are kept. (budget)"""


@dataclass
class ReadingScorer:
    """Evidence of readings of one case on its samples; equations of the last few motions are kept.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
    """

    arm: NominalArm
    body: RigidBody
    samples: FaultSamples
    _equations: dict[tuple[object, ...], ReadingEquations] = field(default_factory=dict)
    _bodies: dict[tuple[object, ...], RigidBody | None] = field(default_factory=dict)

    @property
    def charge(self) -> float:
        """What a value that was fitted owes [nats], by the Bayesian information criterion."""
        return 0.5 * math.log(self.samples.independent)

    def evidence(self, reading: Reading) -> float:
        """Evidence of a reading [nats]; that of an arm that cannot be is minus infinity."""
        eq = self.equations_of(reading)
        return -math.inf if eq is None else evidence(eq, reading)

    def late_by_joint(self, reading: Reading) -> np.ndarray:
        """By how much a torque that is late on all joints is likelier than one that is on all but each [nats], (n,)."""
        body = self._body(reading)
        assert body is not None
        late = np.full(self.arm.n_joints, reading.recorded_delay)
        every = self.evidence(reading)
        out = np.empty(len(late))
        for j in range(len(late)):
            delay = np.where(np.arange(len(late)) == j, 0.0, late)
            eq = reading_equations(self.arm, body, self.samples, reading, delay)
            out[j] = every - evidence(eq, reading)
        return out

    def support_of_bodies(self, reading: Reading) -> float:
        """By how much the nominal bodies as they are explain the torque better than none beside free joints [nats]."""
        eq = self.equations_of(reading)
        if eq is None:
            return -math.inf
        right = np.zeros(len(eq.bodies))
        none = _evidence(eq, reading, right, bodies=False)
        return _evidence(eq, reading, right) - none

    def gravity_turn(self, reading: Reading) -> tuple[float, float] | None:
        """Roll and pitch [rad] of the base that the torque shows under a reading which does not turn it yet."""
        found = self.gravity_shown(reading)
        return None if found is None else turn_of_base(self.arm.gravity, found)

    def gravity_shown(self, reading: Reading) -> np.ndarray | None:
        """Gravity in the base frame by the torque under a reading [m/s^2], (3,); ``None`` if there is none in it."""
        body = self._body(reading)
        # a torque without gravity in it shows no direction
        if body is None or not body.gravity.any() or reading.gravity:
            return None
        q, dq, ddq = reading.true_motion(
            self.samples.q, self.samples.dq, self.samples.ddq
        )
        tau = reading.torque(self.samples.torque(reading.recorded_delay))
        regressor = body.gravity_regressor(q)
        needed = body.inverse_dynamics(q, dq, ddq) + self.arm.armature * ddq
        # what is left is what gravity gives, in whatever direction it points
        without_gravity = tau - needed + regressor @ body.gravity
        return gravity_by_torque(without_gravity, regressor, dq, torque_deviation(tau))

    def equations_of(self, reading: Reading) -> ReadingEquations | None:
        """Equations under a reading; ``None`` if its inertials leave no arm."""
        key = reading.equation_key
        if key not in self._equations:
            body = self._body(reading)
            if body is None:
                return None
            # a dictionary keeps its order: the first key is the oldest
            if len(self._equations) > KEPT_EQUATIONS:
                oldest = next(iter(self._equations))
                del self._equations[oldest]
            self._equations[key] = reading_equations(
                self.arm, body, self.samples, reading
            )
        return self._equations[key]

    def _body(self, reading: Reading) -> RigidBody | None:
        """Dynamics with the inertials moved and the base turned; ``None`` if a joint is then without a body."""
        key = (reading.link_shift, reading.moved_only, reading.turn)
        if key not in self._bodies:
            try:
                arm = shifted_arm(self.arm, reading.link_shift, reading.moved_only)
                body = self.body if arm is self.arm else RigidBody(arm)
                if any(reading.turn):
                    gravity = tilt(*reading.turn).T @ body.gravity
                    body = body.changed(np.zeros((self.arm.n_joints, 10)), gravity)
                self._bodies[key] = body
            except InputError:
                self._bodies[key] = None
        return self._bodies[key]


# The base as the torque shows it: gravity's three components are linear in the torque of every joint,
#
#     tau_j - (bodies without gravity)_j = G_j(q) g + c_j sgn dq_j + b_j dq_j + o_j,  g of known size
#
# so that a base mounted in another way than the case says, or a wrong sign of its gravity, is found without a search.

GRAVITY_SIZE_FACTOR = 2.0
"""A vector fitted in gravity's place counts as gravity if its size is right within this factor [1]: inertials and
torque scales are off by less. (hand)"""
MIN_TURN = 0.4
"""Gravity off by less than this is a tilt, which a linearised search finds [rad]. (hand)"""


def gravity_by_torque(
    torque: np.ndarray, regressor: np.ndarray, dq: np.ndarray, deviation: np.ndarray
) -> np.ndarray:
    """Gravity in the base frame [m/s^2], (3,), by least squares over all joints, each over its torque's deviation.

    Args:
        torque: recorded torque less what the nominal bodies need without gravity [N m], (M, n).
        regressor: G(q) [kg m], (M, n, 3).
        dq: [rad/s], (M, n).
        deviation: standard deviation of each joint's torque [N m], (n,).
    """
    gram, target = np.zeros((3, 3)), np.zeros(3)
    for j, size in enumerate(deviation):
        sign = smooth_sign(dq[:, j])
        # while dry friction holds the joint its torque may be any
        slides = np.abs(sign)
        own = np.column_stack([sign, dq[:, j], np.ones(len(dq))])
        basis, _ = np.linalg.qr(own * slides[:, None])
        x = regressor[:, j] * (slides / size)[:, None]
        y = torque[:, j] * slides / size
        # what the joint's own friction and offset explain is taken out of both sides
        x, y = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
        gram += x.T @ x
        target += x.T @ y
    # directions that no joint shows stay zero
    return np.linalg.lstsq(gram, target, rcond=1e-6)[0]


def turn_of_base(nominal: np.ndarray, found: np.ndarray) -> tuple[float, float] | None:
    """Roll and pitch [rad] of the base with R^T nominal along ``found``, R = Ry(pitch) Rx(roll).

    ``None`` if ``found`` is no gravity, its size off by more than ``GRAVITY_SIZE_FACTOR``; if it is turned by less than
    ``MIN_TURN``; or if no turn comes near it.

    Args:
        nominal: gravity in the base frame as the case has it [m/s^2], (3,).
        found: as the torque shows it [m/s^2], (3,).
    """
    size, size_found = np.linalg.norm(nominal), np.linalg.norm(found)
    if size == 0 or size_found == 0:
        return None
    if abs(np.log(size_found / size)) > np.log(GRAVITY_SIZE_FACTOR):
        return None
    direction = found / size_found
    if nominal @ direction / size > np.cos(MIN_TURN):
        return None

    def miss(turn: np.ndarray) -> np.ndarray:
        return tilt(*turn).T @ nominal / size - direction

    # the nearest of a coarse grid first: there are several minima
    starts = itertools.product(np.arange(-3, 4) * np.pi / 3, (-1.0, 0.0, 1.0))
    nearest = min(starts, key=lambda turn: float(np.sum(miss(np.array(turn)) ** 2)))
    bounds = np.array([np.pi, np.pi / 2])
    best = least_squares(miss, nearest, bounds=(-bounds, bounds))
    # what no turn of the base comes nearer to
    if np.linalg.norm(best.fun) > MIN_TURN:
        return None
    roll, pitch = best.x.tolist()
    return roll, pitch


def as_mounted(arm: NominalArm, segments: Sequence[Segment]) -> NominalArm:
    """The arm with the gravity that its torque shows, if that makes the torque likelier by what is ``UNUSUAL``."""
    segments = [s for s in segments if s.torque is not None]
    if not segments:
        return arm
    samples, as_read = sample(segments), Reading.identity(arm.n_joints)
    scorer = ReadingScorer(arm, RigidBody(arm), samples)
    found = scorer.gravity_shown(as_read)
    if found is None or turn_of_base(arm.gravity, found) is None:
        return arm
    # the size of gravity is known: only its direction is news
    found *= np.linalg.norm(arm.gravity) / np.linalg.norm(found)
    turned = replace(arm, gravity=found)
    gain = ReadingScorer(turned, RigidBody(turned), samples).evidence(as_read)
    return turned if gain - scorer.evidence(as_read) > UNUSUAL else arm
