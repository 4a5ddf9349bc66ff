"""On which side of the joint torque sensors a gap lies: the actuator's, or the link's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.diagnosis.assessment.unknown import unknown
from gapscope.diagnosis.locate import stacked
from gapscope.diagnosis.thresholds import (
    SENSOR_LAG,
    SENSOR_SCALE,
    SENSOR_ZERO,
    UNKNOWN_TORQUE,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.model.conditioning import (
    MIN_FLOOR,
    TORQUE_CUTOFF,
    condition,
    torque_scale,
)
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.rows import DecimatedSegments
from gapscope.model.torque_gap import TorqueGap

# A sensor behind the gear reads what reaches the link,
#
#     tau_sensor = (1 + e) tau_link(t - T) + z + noise,    tau_link = M(q) ddq + ... + k (q - q0) - J^T f,
#
# with its own zero z, scale e and lag T, all unknown. The residual, tau - tau_sensor, is the actuator's: rotor,
# friction, and all between the recorded torque and the gear.


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
    """Derivatives of the readings by each sensor's zero, scale and lag, over their spread, shape (N, n, 3).

    Args:
        link: predicted link torque [N m], (N, n).
        t: time [s], (N,).
        spread: of the zeros [N m], (n,).
    """
    rate = np.gradient(link, t, axis=0)
    zero = np.broadcast_to(spread, link.shape)
    return np.stack([zero, SENSOR_SCALE * link, -SENSOR_LAG * rate], axis=2)


CARRIED_BY = {
    (True, True): "both",
    (True, False): "actuator",
    (False, True): "link",
    (False, False): "neither",
}
"""What carries the gap of a joint, by whether it stands above the floor on the actuator's side and on the link's."""


def find_sides(
    nominal: CorrectedArm,
    corrected: CorrectedArm,
    body: RigidBody,
    recordings: Sequence[Recording],
) -> dict[str, Any] | None:
    """``sides`` of ``diagnosis.json``: the gap on both sides; ``None`` if no recording has sensors.

    Actuator side: recorded torque less sensor, against rotor, friction and all on the way to the gear. Link side: the
    sensor, against the bodies and what acts on them. Both have the norm of the recorded torque. The sensors' own errors
    are fitted to what the corrected arm leaves on the link side, and taken out of both.

    Args:
        nominal, corrected: the arm of the data sheet, and with the effects found.
        body: dynamics of the nominal arm.
        recordings: on which gaps are measured.
    """
    # at their own rate: dry friction is sharp
    sensed = [s for r in recordings if r.tau_sensor is not None for s in condition(r)]
    if not sensed:
        return None
    rows = DecimatedSegments(sensed, TORQUE_CUTOFF)
    moved = stacked(rows)
    scale = torque_scale(rows.rows(s.recorded_torque for s in sensed))
    spread = SENSOR_ZERO * scale
    links = [link_torque(corrected, s.bodies(body), s.motion) for s in sensed]
    every = [
        sensor_errors(link, s.motion.t, spread)
        for s, link in zip(sensed, links, strict=True)
    ]
    left = [s.torque_sensor - link for s, link in zip(sensed, links, strict=True)]
    errors = _fitted_errors(rows.rows(every), rows.rows(left), moved.segment)
    readings = [
        s.torque_sensor - np.einsum("tjk,jk->tj", x, errors)
        for s, x in zip(sensed, every, strict=True)
    ]
    both = [_side_gaps(arm, body, rows, readings) for arm in (nominal, corrected)]
    sides, above, n = {}, [], len(scale)
    # columns of the gap: all joints on the actuator's side, then on the link's
    for name, own in (("actuator", slice(0, n)), ("link", slice(n, None))):
        before, gap = (TorqueGap(*side[:, :, own]) for side in both)
        trust, noise2 = np.ones_like(gap.error), np.zeros_like(scale)
        found = unknown(gap, moved, trust, scale, noise2)
        # what follows the motion has a cause; the rest is the floor
        floor2 = np.maximum(gap.rmse**2 - found.follows2, MIN_FLOOR**2) / scale**2
        given = before.rmse / scale
        # above the floor by what is worth a search
        above.append(given**2 > floor2 + UNKNOWN_TORQUE**2)
        sides[name] = {
            "before": {
                "torque_nrmse": given,
                "floor": np.sqrt(floor2),
            },
            "after": {"torque_nrmse": gap.rmse / scale},
        }
    zero, gain, lag = errors.T
    effects = []
    for effect in corrected.effects:
        about = {"effect": effect.name, "joints": effect.joints}
        effects.append({**about, "side": effect.effect.side})
    return {
        **sides,
        "carried_by": [
            CARRIED_BY[bool(a), bool(b)] for a, b in zip(*above, strict=True)
        ],
        "sensor": {
            "zero": {"unit": "N m", "value": spread * zero},
            "scale": {"unit": "1", "value": SENSOR_SCALE * gain},
            "lag": {"unit": "s", "value": SENSOR_LAG * lag},
        },
        "recordings": list(dict.fromkeys(s.recording for s in sensed)),
        "effects": effects,
    }


def _fitted_errors(x: np.ndarray, gap: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Zero, scale and lag of each sensor over their spread, (n, 3), by what an arm leaves of the link side.

    Args:
        x: derivatives of the readings, (M, n, 3).
        gap: what they differ by from the link torque that the arm predicts [N m], (M, n).
        segment: number of the segment of each row, (M,).
    """
    gram, right = np.einsum("tja,tjb->jab", x, x), np.einsum("tja,tj->ja", x, gap)
    noise2 = (gap**2).mean(axis=0)
    # rows count as the noise that is left about what they tell
    for _ in range(2):
        # columns are over the spread of each error: its prior is of unit size
        normal = gram / noise2[:, None, None] + np.eye(3)
        value = np.linalg.solve(normal, (right / noise2[:, None])[:, :, None])[:, :, 0]
        rest = gap - np.einsum("tja,ja->tj", x, value)
        inflation = variance_inflation(rest, segment)
        noise2 = np.maximum((rest**2).mean(axis=0) * inflation, MIN_FLOOR**2)
    return value


def _side_gaps(
    arm: CorrectedArm,
    body: RigidBody,
    rows: DecimatedSegments,
    readings: list[np.ndarray],
) -> np.ndarray:
    """Torque recorded and predicted [N m], actuator side of each joint, then link side, (2, M, 2 n).

    Args:
        arm: that predicts.
        body: dynamics of the nominal arm.
        rows: of segments with sensors.
        readings: what the sensors read without their own errors [N m], (N, n) each.
    """
    measured, predicted = [], []
    for s, sensor in zip(rows.segments, readings, strict=True):
        # Recorded torque less sensor is what rotor and friction took; the sensor is what the link needed.
        laden = s.bodies(body)
        link = link_torque(arm, laden, s.motion)
        needed = arm.unlimited.predict(laden, s.motion)
        delivered = arm.delivered(s.recorded_torque, s.motion)
        measured.append(np.hstack([delivered - sensor, sensor]))
        predicted.append(np.hstack([needed - link, link]))
    return np.stack([rows.rows(measured), rows.rows(predicted)])
