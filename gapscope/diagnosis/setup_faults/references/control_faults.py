"""Faults about the control law: a velocity reference it ignores, other gains, a torque that gains alone gave.

The law is compared with the torque recorded; if none was, with what the nominal arm needs on the recorded motion. Laws
are fitted to every other block of the recordings and judged on the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.reading import Reading, references
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.setup_faults.references.control_rows import ControlRows
from gapscope.diagnosis.thresholds import (
    EXACT_LAW,
    INFERRED_GAIN_FACTOR,
    INFERRED_GAIN_SPREAD,
    LAW_EXPLAINS,
    LAW_GAIN,
    NAMED_GAIN_FACTOR,
    OBVIOUS_FAULT_PROBABILITY,
    OTHER_GAINS_MISFIT,
    UNMEASURED_MISFIT,
)
from gapscope.effects.setup_faults.controller_faults import (
    GainMismatch,
    UnmeasuredTorque,
)
from gapscope.effects.setup_faults.fault import Values
from gapscope.effects.setup_faults.reference_faults import IgnoredVelocityReference


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
