"""What references and a known controller say: wrong gains, laws, clocks and sources of velocity."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.control import PD, feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.reading import Reading, references
from gapscope.arm.recording import Recording, SetPoints, set_points
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.thresholds import (
    EXACT_LAW,
    FAULT_SIGN_WIDTH,
    INFERRED_GAIN_FACTOR,
    INFERRED_GAIN_SPREAD,
    LAW_BLOCKS,
    LAW_EXPLAINS,
    LAW_GAIN,
    MIN_MOTION_SHARE,
    NAMED_GAIN_FACTOR,
    NAMED_RATE_ERROR,
    OBVIOUS_FAULT_PROBABILITY,
    OTHER_GAINS_MISFIT,
    PACE_FIT_SHARE,
    PACE_GAIN,
    PACE_LAGS,
    PACE_MISFIT,
    PACE_SAMPLES,
    PACE_STARTS,
    PACE_TRACKED,
    RATE_BAND,
    REFERENCE_VELOCITY_RATIO,
    STEPS_IN_TORQUE,
    UNMEASURED_MISFIT,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.setup_faults import (
    CoarseReference,
    Fault,
    GainMismatch,
    IgnoredVelocityReference,
    SpeedScaling,
    UnmeasuredTorque,
    Values,
    VelocityOfReference,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, condition, low_pass

# What a PD law is compared on: tracking errors and torque of a case, in rows to fit and rows to judge.


CLIPPED = 0.98
"""Torque over its limit from which on it may be clipped [1]."""


@dataclass(frozen=True)
class ControlRows:
    """Rows of all recordings with a reference, M of n joints.

    Attributes:
        error: q_ref - q [rad], (M, n).
        dq_ref, dq: velocities [rad/s], (M, n).
        torque: recorded less the declared feedforward [N m], (M, n); that which the nominal arm needs if none was
            recorded.
        needed: what the nominal arm needs, friction included [N m], (M, n).
        feedforward: declared [N m], (M, n); zero without a declared controller.
        gravity: torque of gravity of 1 m/s^2 along each axis of the base [N m], on the reference, (M, n, 3); zero
            without a declared feedforward, which may believe in another gravity.
        recorded: whether ``torque`` was.
        fitted: rows to fit, (M,); the others judge.
        moves: joints that move, (n,).
        free: rows on which a joint's torque is below its limit, (M, n).
    """

    error: np.ndarray
    dq_ref: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    needed: np.ndarray
    feedforward: np.ndarray
    gravity: np.ndarray
    recorded: bool
    fitted: np.ndarray
    moves: np.ndarray
    free: np.ndarray

    @property
    def rate(self) -> np.ndarray:
        """dq_ref - dq [rad/s], (M, n)."""
        return self.dq_ref - self.dq

    def any_gravity(self, joint: int) -> list[np.ndarray]:
        """Columns of gravity in any direction, (M,) each; none without a declared feedforward."""
        columns = self.gravity[:, joint].T
        return list(columns) if columns.any() else []

    def friction(self, joint: int) -> list[np.ndarray]:
        """Columns of dry and viscous friction, (M,) each."""
        dq = self.dq[:, joint]
        return [np.tanh(dq / FAULT_SIGN_WIDTH), dq]

    def fit(
        self, joint: int, target: np.ndarray, columns: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, float]:
        """Coefficients of columns and an offset for a target, and what they leave of it on rows that judge.

        Args:
            joint: from 0.
            target: (M, n), of which the joint's column is explained.
            columns: (M,) each.
        """
        y = target[:, joint]
        x = np.column_stack([*columns, np.ones_like(y)])
        usable = self.free[:, joint]
        fitted = self.fitted & usable
        coefficients = np.linalg.lstsq(x[fitted], y[fitted], rcond=None)[0]
        return coefficients, self.left(joint, y - x @ coefficients, y)

    def left(self, joint: int, residual: np.ndarray, target: np.ndarray) -> float:
        """RMS of a residual over the target's deviation on the rows that judge [1], (M,) both."""
        judged = ~self.fitted & self.free[:, joint]
        deviation = max(float(target[judged].std()), 1e-12)
        return float(np.sqrt(np.mean(residual[judged] ** 2))) / deviation


def control_rows(case: Case) -> ControlRows | None:
    """Rows of a case in the band of the torque gap; ``None`` without references."""
    recordings = [r for r in case.recordings if r.q_ref is not None]
    if not recordings:
        return None
    recorded = all(r.tau is not None for r in recordings)
    body = RigidBody(case.arm)
    parts = [_rows(case, body, r, recorded) for r in recordings]
    series = [np.concatenate(x) for x in zip(*parts, strict=True)]
    error, dq_ref, dq, torque, needed, forward, gravity, free = series
    planned = np.max(
        [np.ptp(references(r, "controller")[0], axis=0) for r in recordings], axis=0
    )
    return ControlRows(
        error,
        dq_ref,
        dq,
        torque,
        needed,
        forward,
        gravity,
        recorded,
        np.concatenate([_fitted(len(p[0])) for p in parts]),
        planned > MIN_MOTION_SHARE * planned.max(),
        free.astype(bool),
    )


def _fitted(count: int) -> np.ndarray:
    """Every other block of a recording's rows, (count,)."""
    return np.arange(count) * LAW_BLOCKS // count % 2 == 0


def _rows(
    case: Case, body: RigidBody, recording: Recording, recorded: bool
) -> list[np.ndarray]:
    """Error, velocities, torque, needed torque, and rows below the limit of one recording, (M, n) each."""
    segments = condition(recording)
    rows: list[list[np.ndarray]] = []
    for segment in segments:
        motion = segment.motion
        q_ref, dq_ref, q, dq = _on_grid(recording, motion.t, _filter_delay(case))
        bodies = body.carrying(segment.payload)
        needed = CorrectedArm(case.arm).predict(bodies, motion)
        torque = needed if segment.torque is None or not recorded else segment.torque
        limit = case.arm.torque_limit
        free = np.ones_like(torque)
        if limit is not None and recorded:
            free = (np.abs(torque) < CLIPPED * limit).astype(float)
        forward = np.zeros_like(torque)
        gravity = np.zeros((*torque.shape, 3))
        if isinstance(case.controller, PD):
            # finite differences of a log at 100 Hz lose some per cent of a fast reference's acceleration
            ddq_ref = make_interp_spline(motion.t, dq_ref, k=5)(motion.t, 1)
            kind = case.controller.feedforward
            forward = feedforward(case.arm, body, kind, q_ref, dq_ref, ddq_ref)
            if kind != "none":
                gravity = body.gravity_regressor(q_ref)
        filtered = [
            low_pass(x, motion.rate, TORQUE_CUTOFF)[segment.inner]
            for x in (q_ref - q, dq_ref, dq, torque - forward, needed, forward, gravity)
        ]
        rows.append([*filtered, free[segment.inner]])
    return [np.concatenate(x) for x in zip(*rows, strict=True)]


def _filter_delay(case: Case) -> float:
    """Delay of the declared controller's velocity filter at low frequency, 2 zeta / w [s]; 0 if there is none."""
    controller = case.controller
    if controller is None or controller.velocity_cutoff is None:
        return 0.0
    return controller.velocity_damping / (np.pi * controller.velocity_cutoff)


def _on_grid(recording: Recording, t: np.ndarray, delay: float) -> list[np.ndarray]:
    """q_ref, dq_ref, q, dq of a recording at other times [s], (M, n) each.

    A velocity that was not recorded is that of the positions a ``delay`` ago, as a controller's filter has it.
    """
    q_ref, dq_ref = references(recording, "controller")
    dq, dq_time = recording.dq, t
    if dq is None:
        dq, dq_time = np.gradient(recording.q, recording.t, axis=0), t - delay
    series = ((t, q_ref), (t, dq_ref), (t, recording.q), (dq_time, dq))
    return [
        np.column_stack([np.interp(at, recording.t, column) for column in x.T])
        for at, x in series
    ]


# Whose derivative a recorded velocity is: the arm's position or the reference.


def is_of_reference(recording: Recording) -> bool:
    """Whether the recorded velocity is decidedly nearer to the reference's than to that of the positions.

    Below ``RATE_BAND``, on both halves, and on each joint that moves; up to a factor, which may be a wrong rate's or
    unit's. An arm led by hand, whose reference follows the position, has no such joint.
    """
    if recording.dq is None or recording.q_ref is None or len(recording.t) < 50:
        return False
    q_ref, dq_ref = references(recording, "dq")
    rate = recording.rate
    cutoff = min(RATE_BAND, 0.2 * rate)
    by_position = np.gradient(recording.q, recording.t, axis=0)
    series = (recording.dq, dq_ref, by_position)
    dq, planned, derived = (low_pass(x, rate, cutoff) for x in series)
    moves = np.ptp(q_ref, axis=0) > MIN_MOTION_SHARE * np.ptp(q_ref, axis=0).max()
    half = len(dq) // 2
    for rows in (slice(None, half), slice(half, None)):
        from_planned = _unlike(dq[rows], planned[rows])[moves]
        from_derived = _unlike(dq[rows], derived[rows])[moves]
        if not (from_planned < REFERENCE_VELOCITY_RATIO * from_derived).all():
            return False
    return bool(moves.any())


def _unlike(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """RMS of what x leaves of the multiple of y nearest to it, of each column, (n,)."""
    factor = (x * y).sum(axis=0) / np.maximum((y**2).sum(axis=0), 1e-12)
    return np.sqrt(((x - factor * y) ** 2).mean(axis=0))


# A reference at another pace than the arm: q(t) = q_ref(t0 + s (t - t0) - d), with a constant s and a lag d.


def pace(recording: Recording) -> float | None:
    """s of a recording [1]; ``None`` if its reference and the arm go at one pace, or at none that is constant.

    Fitted to the first part of the recording, judged on the rest.
    """
    if recording.q_ref is None:
        return None
    rows = np.linspace(0, len(recording.t) - 1, PACE_SAMPLES).astype(int)
    t, q = recording.t[rows] - recording.t[0], recording.q[rows]
    scale = np.maximum(np.ptp(q, axis=0), 1e-9)
    moving = scale > 0.1 * scale.max()
    planned = (recording.t - recording.t[0], recording.q_ref[:, moving])
    q, scale = q[:, moving], scale[moving]

    def error(x: np.ndarray) -> np.ndarray:
        """Positions less the reference at a pace and lag, over their ranges, with the mean error of each joint out."""
        at = x[0] * t - x[1]
        there = np.column_stack([np.interp(at, planned[0], c) for c in planned[1].T])
        difference = (q - there) / scale
        return np.asarray(difference - difference[fitted].mean(axis=0))

    fitted = t <= PACE_FIT_SHARE * t[-1]
    same = min((np.array([1.0, d]) for d in PACE_LAGS), key=lambda x: _rms(error(x)))
    if _rms(error(same)[~fitted]) < PACE_TRACKED:
        return None
    starts = (np.array(x) for x in itertools.product(PACE_STARTS, PACE_LAGS))
    best = min(starts, key=lambda x: _rms(error(x)[fitted]))
    found = least_squares(
        lambda x: error(x)[fitted].ravel(), best, x_scale=(0.01, 0.01)
    ).x
    # what was not fitted decides; beyond the end of the reference there is nothing to compare
    judged = ~fitted & (found[0] * t <= planned[0][-1])
    if (
        judged.sum() < 0.1 * len(t)
        or abs(np.log(max(found[0], 1e-9))) < NAMED_RATE_ERROR
    ):
        return None
    left = _rms(error(found)[judged])
    if left > PACE_MISFIT or left * PACE_GAIN > _rms(error(same)[judged]):
        return None
    return float(found[0])


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


# Faults about the control law: a velocity reference it ignores, other gains, a torque that gains alone gave.
#
# The law is compared with the torque recorded; if none was, with what the nominal arm needs on the recorded motion.
# Laws are fitted to every other block of the recordings and judged on the rest.


@dataclass(frozen=True)
class OtherGainsAtWork(UnmeasuredTorque):
    """A torque that gains gave while others were at work, which are known.

    Attributes:
        joints: from 1.
        kp, kd: of the column [N m/rad], [N m s/rad].
        kp_at_work, kd_at_work: of the controller, one for all joints or one for each.
    """

    parameters = (
        *UnmeasuredTorque.parameters,
        *(replace(x, name=f"{x.name}_at_work") for x in UnmeasuredTorque.parameters),
    )
    kp_at_work: Values = 0.0
    kd_at_work: Values = 0.0

    def reading(self, n: int) -> Reading:
        """With the torque that the gains at work gave."""
        joints = self.columns(n)
        kp, kd = (self.per_joint(x, len(joints)) for x in ("kp_at_work", "kd_at_work"))
        gains = zip(kp.tolist(), kd.tolist(), strict=True)
        law = dict(zip(joints.tolist(), gains, strict=True))
        return Reading.identity(n, law=tuple(law.get(j) for j in range(n)))


def ignored_velocity(case: Case, rows: ControlRows) -> FoundFault | None:
    """A velocity reference that the controller ignores: without it the law explains the torque, with it not.

    Half of the joints that move have to show it, none the contrary.
    """
    recordings = [r for r in case.recordings if r.q_ref is not None]
    if any(r.dq_ref is None for r in recordings):
        return None
    leads: list[float] = []
    moving = np.flatnonzero(rows.moves)
    for j in moving:
        columns = rows.error[:, j], -rows.dq[:, j]
        gains, without = rows.fit(j, rows.torque, columns)
        _, with_it = rows.fit(j, rows.torque, (rows.error[:, j], rows.rate[:, j]))
        if with_it * LAW_GAIN < without and with_it < LAW_EXPLAINS:
            return None
        explains = without < LAW_EXPLAINS and without * LAW_GAIN < with_it
        if explains and gains[0] > 0 and gains[1] > 0:
            leads.append(float(gains[1] / gains[0]))
    if 2 * len(leads) < max(len(moving), 1):
        return None
    value = float(np.median(leads))
    std = max(float(np.std(leads)), 1e-3 * value)
    fault = IgnoredVelocityReference(value)
    return FoundFault(fault, OBVIOUS_FAULT_PROBABILITY, {"lead": (std,)})


def other_gains(case: Case, rows: ControlRows) -> FoundFault | None:
    """Gains at work that are not the declared ones, on the joints that show it."""
    declared = case.controller
    if not isinstance(declared, PD):
        return None
    least = np.log(NAMED_GAIN_FACTOR if rows.recorded else INFERRED_GAIN_FACTOR)
    factors: dict[int, np.ndarray] = {}
    for j in np.flatnonzero(rows.moves):
        error, rate = rows.error[:, j], rows.rate[:, j]
        # a wrong gravity in the feedforward must not pass for gains: errors under a load go with gravity too
        gravity = rows.any_gravity(j)
        gains, left = rows.fit(j, rows.torque, (error, rate, *gravity))
        stated = np.array([declared.kp[j], declared.kd[j]])
        as_declared = _left_beside(rows, j, rows.torque, stated, gravity)
        explains = left < LAW_EXPLAINS and left * LAW_GAIN < as_declared
        if not explains or (gains[:2] <= 0).any() or (stated <= 0).any():
            continue
        factor = gains[:2] / stated
        if np.abs(np.log(factor)).max() > least:
            factors[int(j) + 1] = factor
    if not factors:
        return None
    kp, kd = np.array(list(factors.values())).T
    if not rows.recorded:
        alike = np.ptp(np.log(kp)) < np.log(INFERRED_GAIN_SPREAD)
        if 2 * len(factors) <= rows.moves.sum() or not alike:
            return None
    fault = GainMismatch(tuple(kp.tolist()), tuple(kd.tolist()), tuple(factors))
    return FoundFault(fault, OBVIOUS_FAULT_PROBABILITY)


def exact_gains(recordings: tuple[Recording, ...]) -> np.ndarray | None:
    """kp and kd of each joint, (n, 2), if the torque is kp (q_ref - q) + kd (dq_ref - dq) to rounding in all rows.

    ``None`` if any moving joint's is not. Gains of joints that stand still are zero.
    """
    known = [r for r in recordings if r.tau is not None and r.q_ref is not None]
    if not known or len(known) < len(recordings) or any(r.dq is None for r in known):
        return None
    gains = np.zeros((known[0].n_joints, 2))
    for j in range(len(gains)):
        x, y = zip(*(_law_columns(r, j) for r in known), strict=True)
        columns, torque = np.concatenate(x), np.concatenate(y)
        if torque.std() == 0:
            continue
        fitted = np.arange(len(torque)) % 2 == 0
        gains[j] = np.linalg.lstsq(columns[fitted], torque[fitted], rcond=None)[0]
        residual = (torque - columns @ gains[j])[~fitted]
        if np.sqrt(np.mean(residual**2)) > EXACT_LAW * torque.std():
            return None
    return gains if gains.any() else None


def _law_columns(recording: Recording, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Error and its rate, (N, 2), and torque, (N,), of one joint."""
    assert recording.tau is not None and recording.dq is not None
    q_ref, dq_ref = references(recording, "controller")
    error, rate = q_ref - recording.q, dq_ref - recording.dq
    return np.column_stack([error[:, joint], rate[:, joint]]), recording.tau[:, joint]


def unmeasured_torque(
    case: Case, rows: ControlRows, gains: np.ndarray
) -> FoundFault | None:
    """A torque that gains alone gave, if it does not fit the motion; the gains at work if some do.

    Args:
        case: with torques and references.
        rows: of the case.
        gains: kp and kd of the torque column, (n, 2).
    """
    moving = np.flatnonzero(rows.moves & gains.any(axis=1))
    if not len(moving):
        return None
    declared = case.controller
    if isinstance(declared, PD):
        stated = np.column_stack([declared.kp, declared.kd])
        factor = (stated / np.maximum(gains, 1e-12))[moving]
        if np.abs(np.log(np.maximum(factor, 1e-12))).max() > np.log(NAMED_GAIN_FACTOR):
            return _against_declared(rows, moving, gains, stated)
    return _against_motion(rows, moving, gains)


def _against_declared(
    rows: ControlRows, moving: np.ndarray, gains: np.ndarray, stated: np.ndarray
) -> FoundFault | None:
    """The fault if the declared gains fit the motion better than those of the column: one of the two is at work."""
    misfit = np.median([_left_by(rows, j, gains[j], 0.0) for j in moving])
    other = np.median([_left_by(rows, j, stated[j], 1.0) for j in moving])
    if misfit < OTHER_GAINS_MISFIT or other >= misfit:
        return None
    return _unmeasured(moving, gains, stated)


def _against_motion(
    rows: ControlRows, moving: np.ndarray, gains: np.ndarray
) -> FoundFault | None:
    """The fault if the column fits the motion badly, with any scale and friction, or other gains fit it better."""
    by_column, by_gains, at_work = [], [], gains.copy()
    for j in moving:
        error, rate, friction = rows.error[:, j], rows.rate[:, j], rows.friction(j)
        column = gains[j] @ np.array([error, rate])
        by_column.append(rows.fit(j, rows.needed, (column, *friction))[1])
        found, left = rows.fit(j, rows.needed, (error, rate, *friction))
        by_gains.append(left)
        at_work[j] = found[:2]
    misfit, other = np.median(by_column), np.median(by_gains)
    others_fit = other * LAW_GAIN < misfit and (at_work[moving] > 0).all()
    if misfit < (OTHER_GAINS_MISFIT if others_fit else UNMEASURED_MISFIT):
        return None
    return _unmeasured(moving, gains, at_work if others_fit else None)


def _left_by(rows: ControlRows, joint: int, gains: np.ndarray, share: float) -> float:
    """What gains and a share of the declared feedforward leave of what the nominal arm needs, beside friction [1]."""
    target = rows.needed - share * rows.feedforward
    return _left_beside(rows, joint, target, gains, rows.friction(joint), rows.needed)


def _left_beside(
    rows: ControlRows,
    joint: int,
    target: np.ndarray,
    gains: np.ndarray,
    columns: list[np.ndarray],
    scale: np.ndarray | None = None,
) -> float:
    """What gains, (2,), leave of a joint's column of a target, (M, n), beside free columns and an offset [1].

    Over the deviation of ``scale``, the target by default.
    """
    law = gains @ np.array([rows.error[:, joint], rows.rate[:, joint]])
    remainder = target.copy()
    remainder[:, joint] -= law
    free, _ = rows.fit(joint, remainder, columns)
    x = np.column_stack([*columns, np.ones(len(law))])
    of = target if scale is None else scale
    return rows.left(joint, remainder[:, joint] - x @ free, of[:, joint])


def _unmeasured(
    moving: np.ndarray, gains: np.ndarray, at_work: np.ndarray | None
) -> FoundFault:
    """The fault on joints from 0, with gains of the column and, if they are known, at work, (n, 2) each."""
    joints = tuple((moving + 1).tolist())
    kp, kd = (tuple(column) for column in gains[moving].T.tolist())
    fault = UnmeasuredTorque(kp, kd, joints)
    if at_work is not None:
        others = (tuple(column) for column in at_work[moving].T.tolist())
        fault = OtherGainsAtWork(kp, kd, joints, *others)
    return FoundFault(fault, OBVIOUS_FAULT_PROBABILITY)


# Faults of references, velocities and gains: found from the channels before any torque is worked out from them.


COMPUTED = (
    "the torque is kp (q_ref - q) + kd (dq_ref - dq) to rounding in every row, with kp {kp} N m/rad and kd {kd} "
    "N m s/rad: it was computed from these columns, not measured. No other gains fit the motion decidedly better; what "
    "the loop adds behind them, a delay above all, shows as an effect of the arm"
)
"""Note on a torque that follows from the log's other columns."""


def find_reference_faults(case: Case) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with faults of references, velocities and gains put right, and these, in the order of their repair.

    A torque that was computed rather than measured, and fits the motion, is no fault but a warning of the case.
    """
    found: list[FoundFault] = []
    if not any(r.q_ref is not None for r in case.recordings):
        return case, ()
    for search in (_velocity, _set_points, _pace):
        faults = search((*case.recordings, *case.judged))
        if faults:
            case = repaired(case, faults)
            found.extend(faults)
    try:
        rows = control_rows(case)
    except GapscopeError:
        # too short or gapped for any law; what needs the signals says so
        return case, tuple(found)
    if rows is None:
        return case, tuple(found)
    case, faults = _of_the_law(case, rows)
    return case, (*found, *faults)


def _of_the_law(case: Case, rows: ControlRows) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with what is wrong about its control law put right."""
    gains = exact_gains((*case.recordings, *case.judged))
    if gains is not None:
        fault = unmeasured_torque(case, rows, gains)
        if fault is not None:
            return repaired(case, (fault,)), (fault,)
        if case.controller is None:
            case = replace(case, warnings=(*case.warnings, _computed(gains)))
    for search in (ignored_velocity, other_gains):
        fault = search(case, rows)
        if fault is not None:
            return repaired(case, (fault,)), (fault,)
    return case, ()


def _computed(gains: np.ndarray) -> str:
    kp, kd = (", ".join(f"{x:.4g}" for x in column) for column in gains.T)
    return COMPUTED.format(kp=kp, kd=kd)


def _velocity(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    names = tuple(r.name for r in recordings if is_of_reference(r))
    fault = VelocityOfReference()
    found = FoundFault(fault, OBVIOUS_FAULT_PROBABILITY, recordings=names)
    return (found,) if names else ()


def _set_points(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    """Coarse references that the torque does not follow, one fault for each variant."""
    periods: dict[str, dict[str, float]] = {}
    for recording in recordings:
        points = set_points(recording)
        if points is not None and not _followed(recording, points):
            of_variant = periods.setdefault(points.variant, {})
            of_variant[recording.name] = points.every / recording.rate
    return tuple(
        _by_median(partial(CoarseReference, variant), "period", of_variant)
        for variant, of_variant in periods.items()
    )


def _followed(recording: Recording, points: SetPoints) -> bool:
    """Whether the torque has the steps of the reference, so that the controller did follow them."""
    smooth = points.smooth(recording)
    if recording.tau is None or recording.q_ref is None or smooth.q_ref is None:
        return False
    # what changes faster than set points can tell: half of their rate
    band = recording.rate / points.every / 2
    steps, torque = (
        x - low_pass(x, recording.rate, band)
        for x in (recording.q_ref - smooth.q_ref, recording.tau)
    )
    power = np.sqrt((steps**2).sum(axis=0) * (torque**2).sum(axis=0))
    stepping = power > 0
    if not stepping.any():
        return False
    likeness = (steps * torque).sum(axis=0)[stepping] / power[stepping]
    return bool(np.median(likeness) > STEPS_IN_TORQUE)


def _pace(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    """Other paces, one fault for all recordings at one pace."""
    paces = {r.name: s for r in recordings if (s := pace(r)) is not None}
    faults: list[FoundFault] = []
    while paces:
        first = next(iter(paces.values()))
        alike = {
            name: s
            for name, s in paces.items()
            if abs(np.log(s / first)) < NAMED_RATE_ERROR
        }
        faults.append(_by_median(SpeedScaling, "factor", alike))
        paces = {name: s for name, s in paces.items() if name not in alike}
    return tuple(faults)


def _by_median(
    fault: Callable[[float], Fault], name: str, values: Mapping[str, float]
) -> FoundFault:
    """The fault whose parameter is the median over recordings, and how far these differ."""
    given = list(values.values())
    median = float(np.median(given))
    std = max(float(np.std(given)), 1e-3 * median)
    return FoundFault(
        fault(median), OBVIOUS_FAULT_PROBABILITY, {name: (std,)}, tuple(values)
    )
