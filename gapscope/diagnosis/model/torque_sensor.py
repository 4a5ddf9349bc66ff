"""What joint torque sensors add to the evidence: the gap of a joint in two parts, one on either side of the sensor.

A sensor behind the gear reads what reaches the link,

    tau_sensor = (1 + e) tau_link(t - T) + z + noise,    tau_link = M(q) ddq + ... + k (q - q0) - J^T f,

with its own zero z, scale e and lag T, all unknown. The residual, tau - tau_sensor, is the actuator's: rotor,
friction, and all between the recorded torque and the gear. In place of the rows of the recorded torque come those of

    actuator side    tau - tau_sensor    columns A - A_link,    z, e and T with the opposite sign
    link side        tau_sensor          columns A_link, the nominal inertials' errors, z, e and T

so that an effect has to explain the side that it acts on, and must not show on the other one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.gap.noise_floor import (
    dry_friction,
    simplified_effect_rms,
    steady_floor,
)
from gapscope.diagnosis.model.fold import EquationRows
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    FRICTION_FORM,
    SENSOR_LAG,
    SENSOR_SCALE,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.model.body_point import Bodies, bodily_columns
from gapscope.model.conditioning import Segment
from gapscope.model.jacobian import moved_arms, steps, torque_size
from gapscope.model.prediction import Prediction, without
from gapscope.model.terms import Terms


@dataclass(frozen=True)
class LinkRows:
    """Rows of the joint torque sensors on one segment, M of n joints; zeros if the segment has no sensor.

    Attributes:
        gap: sensor less predicted link torque [N m], (M, n).
        columns: derivatives of the link torque by the terms' coordinates, (M, n, P).
        sensor: derivatives of the reading by zero, scale and lag of each sensor, over their spread, (M, n, 3 n).
        known: whether the segment has sensors.
        floors: RMS of a healthy arm, actuator side of each joint, then link side [N m], (2 n,).
    """

    gap: np.ndarray
    columns: np.ndarray
    sensor: np.ndarray
    known: bool
    floors: np.ndarray


def link_torque(corrected: CorrectedArm, body: RigidBody, motion: Motion) -> np.ndarray:
    """Torque behind the gear that an arm predicts [N m], (N, n): bodies, forces from outside, springs."""
    torque = corrected.rigid_torque(body, motion)
    true = corrected.true_position(motion.q)
    for law, values in corrected.of_kind(TorqueLaw):
        if law.side == "link":
            torque = torque + law.law(
                Signals(motion.t[:, None], true, motion.dq, torque), *values
            )
    return torque


def sensor_errors(link: np.ndarray, t: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Derivatives of the readings by each sensor's zero, scale and lag, over their spread, shape (N, n, 3 n).

    Args:
        link: predicted link torque [N m], (N, n).
        t: time [s], (N,).
        spread: of the zeros [N m], (n,).
    """
    n = link.shape[1]
    out = np.zeros((*link.shape, 3, n))
    for j in range(n):
        out[:, j, 0, j] = spread[j]
        out[:, j, 1, j] = SENSOR_SCALE * link[:, j]
        out[:, j, 2, j] = -SENSOR_LAG * np.gradient(link[:, j], t)
    return out.reshape(len(link), n, 3 * n)


def link_rows(
    corrected: CorrectedArm,
    at: Prediction,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    zero: np.ndarray,
) -> LinkRows:
    """Rows of a segment's joint torque sensors at every sample; the columns of changed links are left zero.

    Args:
        corrected: the arm with the effects of theta.
        at: what it predicts on the segment.
        segment: the segment.
        bodies: what its columns need.
        terms: all terms, with the shapes of those that have one.
        theta: linear coordinates around which to differentiate, shape (P,).
        zero: spread of the sensors' zeros [N m], (n,).
    """
    motion, n = segment.motion, corrected.arm.n_joints
    columns = np.zeros((len(motion.t), n, terms.size))
    if segment.torque_sensor is None:
        nothing = np.zeros_like(motion.q)
        return LinkRows(
            nothing, columns, np.zeros((*nothing.shape, 3 * n)), False, np.ones(2 * n)
        )
    arm, laden = at.arm, at.body
    link = link_torque(arm, laden, motion)
    derivatives = bodily_columns(at, segment, bodies, terms, theta)
    columns[:, :, list(derivatives)] = np.stack(list(derivatives.values()), axis=2)
    joints, size = np.arange(n), torque_size(at)
    for law in explained():
        if not isinstance(law, TorqueLaw) or law.side != "link":
            continue
        step = steps(law, size)
        for i, places in enumerate(terms.block(law.name)):
            arms = moved_arms(arm, terms, theta, law.name, i, step)
            if arms is not None:
                moved, begun = arms
                before = link if begun is None else link_torque(begun, laden, motion)
                change = link_torque(moved, laden, motion) - before
                columns[:, joints, places] = change / step
    floors = [
        floor(corrected, laden, segment) for floor in (actuator_floor, link_floor)
    ]
    return LinkRows(
        segment.torque_sensor - link,
        columns,
        sensor_errors(link, motion.t, zero),
        True,
        np.concatenate(floors),
    )


def link_floor(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> np.ndarray:
    """RMS that a healthy arm and its sensors leave on the link side [N m], (n,)."""
    assert segment.torque_sensor is not None
    body = segment.bodies(body)

    def link(arm: CorrectedArm) -> np.ndarray:
        return link_torque(arm, body, segment.motion)

    form = simplified_effect_rms(corrected, segment, _share(link, corrected))
    gap = segment.torque_sensor - link(corrected)
    return steady_floor(gap, segment.torque_sensor, segment, EFFECT_FORM * form)


def actuator_floor(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> np.ndarray:
    """RMS that a healthy arm leaves on the actuator side where its friction is known [N m], (n,)."""
    assert segment.torque is not None and segment.torque_sensor is not None
    motion, body = segment.motion, segment.bodies(body)

    def actuator(arm: CorrectedArm) -> np.ndarray:
        return arm.unlimited.predict(body, motion) - link_torque(arm, body, motion)

    share = _share(actuator, corrected)
    dry_rms = np.sqrt((dry_friction(corrected, segment) ** 2).mean(axis=0))
    form = np.hypot(
        EFFECT_FORM * simplified_effect_rms(corrected, segment, share),
        FRICTION_FORM * dry_rms,
    )
    gap = (
        corrected.delivered(segment.torque)
        - segment.torque_sensor
        - actuator(corrected)
    )
    return steady_floor(gap, segment.torque, segment, form)


def _share(
    predicted: Callable[[CorrectedArm], np.ndarray], corrected: CorrectedArm
) -> Callable[[AppliedEffect], np.ndarray]:
    """What one of an arm's effects does to the torque that ``predicted`` gives for an arm [N m], (N, n)."""
    whole = predicted(corrected)
    return lambda applied: whole - predicted(without(corrected, applied))


def two_sides(
    torque: EquationRows, links: list[LinkRows], theta: np.ndarray
) -> EquationRows:
    """Equations of both sides of each joint, the actuator sides, then the link sides.

    Without a sensor the actuator side is the whole joint, and the link side says nothing.

    Args:
        torque: equations of the recorded torque, m = n.
        links: what the sensors measured on these rows.
        theta: linear coordinates around which A was taken, shape (P,).

    Returns:
        Equations with m = 2 n.
    """
    gap = np.vstack([rows.gap for rows in links])
    terms = np.vstack([rows.columns for rows in links])
    errors = np.vstack([rows.sensor for rows in links])
    measured = [np.full((len(rows.gap), 1), float(rows.known)) for rows in links]
    known = np.vstack(measured)
    inertials = known[:, :, None] * torque.inertials
    y = gap + terms @ theta
    without = np.hstack([torque.steady2, np.ones_like(torque.steady2)])
    steady2 = np.where(known > 0, _floors2(links), without)
    return EquationRows(
        terms=np.concatenate([torque.terms - terms, terms], axis=1),
        inertials=np.concatenate([torque.inertials - inertials, inertials], axis=1),
        others=np.concatenate([torque.others - errors, errors], axis=1),
        y=np.hstack([torque.y - y, y]),
        # the skew lies between motion and recorded torque: on the actuator side alone
        rate=np.hstack([torque.rate, np.zeros_like(gap)]),
        sticking=np.hstack([torque.sticking, np.zeros_like(gap)]),
        steady2=steady2,
        known=np.hstack([np.ones(gap.shape), np.broadcast_to(known, gap.shape)]),
    )


def _floors2(links: list[LinkRows]) -> np.ndarray:
    """Mean square of a healthy arm with sensors on each row, (M, 2 n)."""
    rows = [np.tile(rows.floors**2, (len(rows.gap), 1)) for rows in links]
    return np.vstack(rows)
