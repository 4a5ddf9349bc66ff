"""What references and a known controller say: wrong gains, laws, clocks and sources of velocity."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.control import FEEDFORWARDS, PD, feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.reading import Reading, references
from gapscope.arm.recording import Recording, SetPoints, set_points
from gapscope.arm.root_mean_square import SMALLEST, rms
from gapscope.diagnosis.setup_faults.found_fault import (
    FoundFault,
    by_recordings,
    repaired,
)
from gapscope.diagnosis.thresholds import (
    EXACT_LAW,
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
    PACE_GAIN,
    PACE_LAGS,
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
    GainMismatch,
    IgnoredVelocityReference,
    SpeedScaling,
    UnmeasuredTorque,
    Values,
    VelocityOfReference,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, condition, low_pass

# What a control law is compared on: tracking errors, motion and torque of each joint, on rows to fit and rows to judge.


CLIPPED = 0.98
"""Torque over its limit from which on it may be clipped [1]. (physical)"""
FRICTION = ("dry", "dq", "one")
"""Columns of dry and viscous friction, and an offset."""
GAINS = ("error", "rate")
"""Columns of kp and kd."""
WEIGHT = ("gravity x", "gravity y", "gravity z")
"""Columns of a feedforward that believes in another gravity."""
SERIES = (
    *FRICTION,
    "ddq",
    *GAINS,
    "integral",
    "torque",
    "needed",
    *FEEDFORWARDS,
    *WEIGHT,
)
"""Series of each joint, K of them: smoothed sign of the velocity, velocity [rad/s], one, acceleration [rad/s^2],
q_ref - q [rad], its rate [rad/s] and integral [rad s], torque recorded (that which the nominal arm needs if none was),
torque that the nominal arm needs with its friction [N m], that which each kind of feedforward has, and that of gravity
of 1 m/s^2 along each axis of the base on the reference."""


@dataclass(frozen=True)
class LawRows:
    """``SERIES`` in the band of the torque gap, on M rows of n joints.

    Attributes:
        series: (M, n, K).
        free: rows of each joint below its torque limit, mask (M, n).
        segment: number of the segment of each row, (M,).
        fitted: rows to fit, mask (M,); the others judge.
        recorded: whether ``torque`` was.
        moves: joints that move, (n,).
    """

    series: np.ndarray
    free: np.ndarray
    segment: np.ndarray
    fitted: np.ndarray
    recorded: bool
    moves: np.ndarray

    def fit(
        self,
        joint: int,
        target: Mapping[str, float],
        columns: Sequence[str],
        scale: Mapping[str, float] | None = None,
    ) -> tuple[np.ndarray, float]:
        """Coefficients of columns for a target, and what they leave of it on rows that judge, RMS over deviation [1].

        Args:
            joint: from 0.
            target: factors of the series that make it.
            columns: names of series.
            scale: factors of the series over whose deviation it counts; by default the target.
        """
        series, free = self.series[:, joint], self.free[:, joint]
        left, whole = (
            series @ [factors.get(name, 0.0) for name in SERIES]
            for factors in (target, target if scale is None else scale)
        )
        x = series[:, [SERIES.index(name) for name in columns]]
        fitted, judged = free & self.fitted, free & ~self.fitted
        # gains, friction and offset differ by orders of magnitude
        size = np.sqrt(np.maximum((x[fitted] ** 2).sum(axis=0), SMALLEST))
        found = np.linalg.lstsq(x[fitted] / size, left[fitted], rcond=1e-6)[0] / size
        rest = rms((left - x @ found)[judged], None)
        return found, float(rest / max(whole[judged].std(), SMALLEST))


Referred = list[tuple[Recording, list[Segment]]]
"""Recordings with references, and their segments."""


def referred(case: Case) -> Referred:
    """The recordings of a case that have references."""
    return [(r, condition(r)) for r in case.recordings if r.q_ref is not None]


def law_rows(case: Case, recordings: Referred, delay: float = 0.0) -> LawRows:
    """Rows of a case's recordings with references, of which there are some, if commands take effect late [s]."""
    recorded = all(r.tau is not None for r, _ in recordings)
    body = RigidBody(case.arm)
    series, free, fitted = [], [], []
    for recording, segments in recordings:
        parts = [_series(case, body, recording, s, recorded, delay) for s in segments]
        series += [x for x, _ in parts]
        free += [y for _, y in parts]
        count = sum(len(x) for x, _ in parts)
        # every other block is fitted
        fitted.append(np.arange(count) * LAW_BLOCKS // count % 2 == 0)
    # by the plan, so that an arm that sags does not count as moving
    planned = np.max(
        [np.ptp(references(r, "controller")[0], axis=0) for r, _ in recordings], axis=0
    )
    return LawRows(
        np.concatenate(series),
        np.concatenate(free),
        np.repeat(np.arange(len(series)), [len(x) for x in series]),
        np.concatenate(fitted),
        recorded,
        planned > MIN_MOTION_SHARE * planned.max(),
    )


def law_kept(segment: Segment) -> slice:
    """Samples of a segment that are rows: twice as many as the band of the torque gap asks for."""
    step = max(1, int(segment.motion.rate / (4 * TORQUE_CUTOFF)))
    return slice(segment.inner.start, segment.inner.stop, step)


def late_references(
    recording: Recording, times: np.ndarray, delay: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Reference positions [rad] and velocities [rad/s] that take effect at times [s] if they are late."""
    late = np.maximum(times - delay, recording.t[0])
    q_ref, dq_ref = (
        make_interp_spline(recording.t, series, k=1)(late)
        for series in references(recording, "controller")
    )
    return q_ref, dq_ref


References = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions [rad], velocities [rad/s] and accelerations [rad/s^2] of references, (N, n) each."""


def law_motion(
    recording: Recording, segment: Segment, delay: float = 0.0, behind: float = 0.0
) -> tuple[np.ndarray, np.ndarray, References]:
    """Position errors [rad] and velocities [rad/s] that a controller sees, (N, n), and its references.

    Args:
        recording: with references.
        segment: of it.
        delay: by which commands take effect late [s].
        behind: by which a velocity that was not recorded comes late, behind the controller's filter [s].
    """
    t, motion = recording.t, segment.motion
    q_ref, dq_ref = late_references(recording, motion.t, delay)
    error = q_ref - make_interp_spline(t, recording.q, k=1)(motion.t)
    seen = np.maximum(motion.t - behind, motion.t[0])
    dq = make_interp_spline(motion.t, motion.dq, k=1)(seen)
    if recording.dq is not None:
        dq = make_interp_spline(t, recording.dq, k=1)(motion.t)
    # finite differences of a log at 100 Hz lose some per cent of a fast reference's acceleration
    ddq_ref = make_interp_spline(motion.t, dq_ref, k=5)(motion.t, 1)
    return error, dq, (q_ref, dq_ref, ddq_ref)


def law_filtered(series: np.ndarray, segment: Segment) -> np.ndarray:
    """Series of a segment, (N, n, K), on its rows behind the filter of the torque gap, (M, n, K)."""
    flat = low_pass(series.reshape(len(series), -1), segment.motion.rate, TORQUE_CUTOFF)
    return flat.reshape(series.shape)[law_kept(segment)]


def _series(
    case: Case,
    body: RigidBody,
    recording: Recording,
    segment: Segment,
    recorded: bool,
    delay: float,
) -> tuple[np.ndarray, np.ndarray]:
    """``SERIES`` of a segment, (M, n, K), and rows of each joint below its torque limit, (M, n).

    A velocity that was not recorded is that of the positions a delay of the controller's filter ago, 2 zeta / w.
    """
    behind, controller = 0.0, case.controller
    if controller is not None and controller.velocity_cutoff is not None:
        behind = controller.velocity_damping / (np.pi * controller.velocity_cutoff)
    motion = segment.motion
    error, dq, planned = law_motion(recording, segment, delay, behind)
    needed = CorrectedArm(case.arm).predict(segment.bodies(body), motion)
    torque = needed if segment.torque is None or not recorded else segment.torque
    limit, free = case.arm.torque_limit, np.ones_like(torque, dtype=bool)
    if limit is not None and recorded:
        # a clipped torque is given by no gain
        free = np.abs(torque) < CLIPPED * limit
    # with what the integral began is not known
    integral = np.cumsum(error, axis=0) / motion.rate
    integral = integral - integral.mean(axis=0)
    dry, one = smooth_sign(motion.dq), np.ones_like(error)
    friction = (dry, dq, one, motion.ddq)
    law = (error, planned[1] - dq, integral, torque, needed)
    fed = [feedforward(case.arm, body, kind, *planned) for kind in FEEDFORWARDS]
    weight = np.moveaxis(body.gravity_regressor(planned[0]), 2, 0)
    every = np.stack([*friction, *law, *fed, *weight], axis=2)
    return law_filtered(every, segment), free[law_kept(segment)]


# Whose derivative a recorded velocity is: the arm's position or the reference.


def is_of_reference(recording: Recording) -> bool:
    """Whether the recorded velocity is decidedly nearer to the reference's than to that of the positions.

    Below ``RATE_BAND``, on each joint that moves, and up to a factor, which may be a wrong rate's or unit's. An arm led
    by hand, whose reference follows the position, has no such joint.
    """
    if recording.dq is None or recording.q_ref is None:
        return False
    q_ref, dq_ref = references(recording, "dq")
    cutoff = min(RATE_BAND, recording.rate / 5)
    by_position = np.gradient(recording.q, recording.t, axis=0)
    dq, planned, derived = (
        low_pass(x, recording.rate, cutoff) for x in (recording.dq, dq_ref, by_position)
    )
    moves = np.ptp(q_ref, axis=0) > MIN_MOTION_SHARE * np.ptp(q_ref, axis=0).max()
    unlike = []
    for other in (planned, derived):
        # up to a factor, by least squares
        power = np.maximum((other**2).sum(axis=0), SMALLEST)
        unlike.append(rms(dq - (dq * other).sum(axis=0) / power * other, 0)[moves])
    nearer = unlike[0] < REFERENCE_VELOCITY_RATIO * unlike[1]
    return bool(moves.any() and nearer.all())


# A reference at another pace than the arm: q(t) = q_ref(t0 + s (t - t0) - d), with a constant s and a lag d.


def pace(recording: Recording) -> float | None:
    """s of a recording [1]; ``None`` if its reference and the arm go at one pace, or at none that is constant.

    Fitted to the first half of the recording, judged on the other.
    """
    if recording.q_ref is None:
        return None
    rows = np.linspace(0, len(recording.t) - 1, PACE_SAMPLES).astype(int)
    t, q = recording.t[rows] - recording.t[0], recording.q[rows]
    moving = np.ptp(q, axis=0) > MIN_MOTION_SHARE * np.ptp(q, axis=0).max()
    q, scale = q[:, moving], np.ptp(q[:, moving], axis=0)
    end, first = t[-1], 2 * t <= t[-1]
    planned = make_interp_spline(
        recording.t - recording.t[0], recording.q_ref[:, moving], k=1
    )

    def error(x: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Positions less the reference at a pace and lag, over their ranges, with the mean error of rows used out."""
        # before its start and after its end a reference rests
        difference = (q - planned(np.clip(x[0] * t - x[1], 0.0, end))) / scale
        return np.asarray(difference - difference[used].mean(axis=0))

    def best(paces: Sequence[float]) -> np.ndarray:
        starts = (np.array(x) for x in itertools.product(paces, PACE_LAGS))
        return min(starts, key=lambda x: rms(error(x, first)[first], None))

    same = error(best([1.0]), first)
    if not moving.any() or rms(same[~first], None) < PACE_TRACKED:
        return None

    def refined(x: np.ndarray, used: np.ndarray) -> np.ndarray:
        done = least_squares(
            lambda y: error(y, used)[used].ravel(), x, x_scale=(0.01, 0.01)
        )
        return np.asarray(done.x)

    found = refined(best(PACE_STARTS), first)
    # what was not fitted decides; beyond the end of the reference there is nothing to compare
    inside = found[0] * t <= end
    judged = ~first & inside
    if (
        not judged.any()
        or abs(np.log(max(found[0], PACE_STARTS[0]))) < NAMED_RATE_ERROR
    ):
        return None
    left = rms(error(found, first)[judged], None)
    if left * PACE_GAIN > rms(same[judged], None):
        return None
    # decided on half of the rows, the value is taken from all
    return float(refined(found, inside)[0])


# Faults about the control law: a velocity reference it ignores, other gains, a torque that gains alone gave.
#
# The law is compared with the torque recorded; if none was, with what the nominal arm needs on the recorded motion.


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


def of_gains(kind: str) -> dict[str, float]:
    """What kp and kd give of the torque, beside a kind of feedforward."""
    return {"torque": 1.0, kind: -1.0}


def _declared(case: Case) -> str:
    """Kind of the declared feedforward."""
    return case.controller.feedforward if isinstance(case.controller, PD) else "none"


def _less_gains(target: Mapping[str, float], gains: np.ndarray) -> dict[str, float]:
    """A target less kp (q_ref - q) + kd (dq_ref - dq), gains (2,)."""
    return {**target, **{name: -float(x) for name, x in zip(GAINS, gains, strict=True)}}


def ignored_velocity(case: Case, rows: LawRows) -> FoundFault | None:
    """A velocity reference that the controller ignores: without it the law explains the torque, with it not.

    Half of the joints that move have to show it, none the contrary.
    """
    recordings = [r for r in case.recordings if r.q_ref is not None]
    if any(r.dq_ref is None for r in recordings):
        return None
    leads: dict[str, float] = {}
    moving, law = np.flatnonzero(rows.moves), of_gains(_declared(case))
    for j in moving:
        # tau = kp (q_ref - q) - kd dq, without the velocity's reference
        gains, without = rows.fit(j, law, ("error", "dq", "one"))
        _, with_it = rows.fit(j, law, (*GAINS, "one"))
        if with_it * LAW_GAIN < without and with_it < LAW_EXPLAINS:
            # one joint that clearly follows its velocity reference settles it
            return None
        explains = without < LAW_EXPLAINS and without * LAW_GAIN < with_it
        # the column is dq, so that a damping has a negative factor
        if explains and gains[0] > 0 > gains[1]:
            leads[str(j)] = float(-gains[1] / gains[0])
    if 2 * len(leads) < max(len(moving), 1):
        return None
    found = by_recordings(IgnoredVelocityReference, "lead", leads, recordings)
    # by joints above, not by recordings: it is of the whole arm
    return replace(found, recordings=())


def other_gains(case: Case, rows: LawRows) -> FoundFault | None:
    """Gains at work that are not the declared ones, on the joints that show it."""
    declared = case.controller
    if not isinstance(declared, PD):
        return None
    least = np.log(NAMED_GAIN_FACTOR if rows.recorded else INFERRED_GAIN_FACTOR)
    factors: dict[int, np.ndarray] = {}
    # a wrong gravity in the feedforward must not pass for gains: errors under a load go with gravity too
    kind = declared.feedforward
    law, others = of_gains(kind), ("one", *(WEIGHT if kind != "none" else ()))
    for j in np.flatnonzero(rows.moves):
        gains, left = rows.fit(j, law, (*GAINS, *others))
        stated = np.array([declared.kp[j], declared.kd[j]])
        _, as_declared = rows.fit(j, _less_gains(law, stated), others, law)
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
    columns, torques = [], []
    for r in recordings:
        if r.tau is None or r.q_ref is None or r.dq is None:
            return None
        q_ref, dq_ref = references(r, "controller")
        columns.append(np.stack([q_ref - r.q, dq_ref - r.dq], axis=2))
        torques.append(r.tau)
    x, torque = np.concatenate(columns), np.concatenate(torques)
    gains = np.zeros((torque.shape[1], 2))
    for j in np.flatnonzero(torque.std(axis=0)):
        # fitted to every other row, judged on the rest
        gains[j] = np.linalg.lstsq(x[::2, j], torque[::2, j], rcond=None)[0]
        residual = (torque[:, j] - x[:, j] @ gains[j])[1::2]
        if rms(residual) > EXACT_LAW * torque[:, j].std():
            return None
    return gains if gains.any() else None


def unmeasured_torque(
    case: Case, rows: LawRows, gains: np.ndarray
) -> FoundFault | None:
    """A torque that gains alone gave, if it does not fit the motion; the gains at work if some do.

    If a controller is declared with other gains, one of the two is at work: it is the fault if what the nominal arm
    needs, but for friction, is explained better by these. Else the column, of any scale, fits the motion badly, or
    other gains fit it better.

    Args:
        case: with torques and references.
        rows: of the case.
        gains: kp and kd of the torque column, (n, 2).
    """
    moving = np.flatnonzero(rows.moves & gains.any(axis=1))
    if not len(moving):
        return None
    declared, at_work, needed = case.controller, gains.copy(), {"needed": 1.0}
    column, others = [], []
    stated = np.zeros_like(gains)
    if isinstance(declared, PD):
        stated = np.column_stack([declared.kp, declared.kd])
    off = np.abs(
        np.log(
            np.maximum(stated[moving], SMALLEST) / np.maximum(gains[moving], SMALLEST)
        )
    )
    if isinstance(declared, PD) and off.max() > np.log(NAMED_GAIN_FACTOR):
        # declared gains come with their feedforward, those of the column without
        at_work, fed = stated, {**needed, _declared(case): -1.0}
        for j in moving:
            own, other = _less_gains(needed, gains[j]), _less_gains(fed, stated[j])
            column.append(rows.fit(j, own, FRICTION, needed)[1])
            others.append(rows.fit(j, other, FRICTION, needed)[1])
        misfit = np.median(column)
        if misfit < OTHER_GAINS_MISFIT or np.median(others) >= misfit:
            return None
    else:
        for j in moving:
            column.append(rows.fit(j, needed, ("torque", *FRICTION))[1])
            found, left = rows.fit(j, needed, (*GAINS, *FRICTION))
            others.append(left)
            at_work[j] = found[:2]
        misfit = np.median(column)
        known = np.median(others) * LAW_GAIN < misfit and (at_work[moving] > 0).all()
        if misfit < (OTHER_GAINS_MISFIT if known else UNMEASURED_MISFIT):
            return None
        # that the torque is wrong is known, which gains were at work is not
        if not known:
            at_work = gains
    joints = tuple((moving + 1).tolist())
    kp, kd = (tuple(x) for x in gains[moving].T.tolist())
    fault = UnmeasuredTorque(kp, kd, joints)
    if at_work is not gains:
        at_work_kp, at_work_kd = (tuple(x) for x in at_work[moving].T.tolist())
        fault = OtherGainsAtWork(kp, kd, joints, at_work_kp, at_work_kd)
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
    # each sees what the one before has put right
    for search in (_velocity, _set_points, _pace):
        faults = search((*case.recordings, *case.judged))
        if faults:
            case = repaired(case, faults)
            found.extend(faults)
    try:
        rows = law_rows(case, referred(case))
    except GapscopeError:
        # too short or gapped for any law; what needs the signals says so
        return case, tuple(found)
    fault, gains = None, exact_gains((*case.recordings, *case.judged))
    if gains is not None:
        fault = unmeasured_torque(case, rows, gains)
        if fault is None and case.controller is None:
            kp, kd = (", ".join(f"{x:.4g}" for x in column) for column in gains.T)
            warning = COMPUTED.format(kp=kp, kd=kd)
            case = replace(case, warnings=(*case.warnings, warning))
    # at most one: all three explain the same torque
    fault = fault or ignored_velocity(case, rows) or other_gains(case, rows)
    if fault is None:
        return case, tuple(found)
    return repaired(case, (fault,)), (*found, fault)


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
        by_recordings(partial(CoarseReference, variant), "period", own, recordings)
        for variant, own in periods.items()
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
    likeness = (steps * torque).sum(axis=0)[stepping] / power[stepping]
    return bool(stepping.any() and np.median(likeness) > STEPS_IN_TORQUE)


def _pace(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    """Other paces, one fault for all recordings at one pace."""
    paces = {r.name: s for r in recordings if (s := pace(r)) is not None}
    faults: list[FoundFault] = []
    while paces:
        first = next(iter(paces.values()))
        near = {
            n for n, s in paces.items() if abs(np.log(s / first)) < NAMED_RATE_ERROR
        }
        alike = {name: paces.pop(name) for name in list(paces) if name in near}
        faults.append(by_recordings(SpeedScaling, "factor", alike, recordings))
    return tuple(faults)
