"""On which side of the joint torque sensors a gap lies: the actuator's, or the link's."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.assessment.unknown import unknown
from gapscope.diagnosis.locate import stack
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
    Segment,
    low_pass,
    torque_scale,
)
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.torque_gap import TorqueGap, filtered_torque

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
    segments: list[Segment],
) -> dict[str, Any] | None:
    """``sides`` of ``diagnosis.json``: the gap on both sides; ``None`` if no segment has sensors.

    Actuator side: recorded torque less sensor, against rotor, friction and all on the way to the gear. Link side: the
    sensor, against the bodies and what acts on them. Both have the norm of the recorded torque. The sensors' own errors
    are fitted to what the corrected arm leaves on the link side, and taken out of both.

    Args:
        nominal, corrected: the arm of the data sheet, and with the effects found.
        body: dynamics of the nominal arm.
        segments: on which gaps are measured.
    """
    sensed = [s for s in segments if s.torque_sensor is not None]
    if not sensed:
        return None
    scale = torque_scale(np.vstack([filtered_torque(s) for s in sensed]))
    spread = SENSOR_ZERO * scale
    errors = _fitted_errors(corrected, body, sensed, spread)
    readings = []
    for s in sensed:
        link = link_torque(corrected, s.bodies(body), s.motion)
        readings.append(
            s.torque_sensor - sensor_errors(link, s.motion.t, spread) @ errors
        )
    before, after = (
        _side_gaps(arm, body, sensed, readings) for arm in (nominal, corrected)
    )
    sides, above, n = {}, [], len(scale)
    # columns of the gap: all joints on the actuator's side, then on the link's
    for side, own in (("actuator", slice(0, n)), ("link", slice(n, None))):
        gap = TorqueGap(after.measured[:, own], after.predicted[:, own], after.edges)
        found = unknown(gap, stack(sensed), np.ones_like(gap.error), scale)
        # what follows the motion has a cause; the rest is the floor
        floor2 = np.maximum(gap.rmse**2 - found.follows2, MIN_FLOOR**2) / scale**2
        given = before.rmse[own] / scale
        above.append(carries(given, np.sqrt(floor2)))
        sides[side] = {
            "before": {
                "torque_nrmse": given,
                "floor": np.sqrt(floor2),
            },
            "after": {"torque_nrmse": gap.rmse / scale},
        }
    zero, gain, lag = errors.reshape(3, -1)
    effects = []
    for effect in corrected.effects:
        about = {"effect": effect.name, "joints": list(effect.joints)}
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


def carries(gap: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Joints on which a torque NRMSE is above the floor by what is worth a search, (n,)."""
    return np.asarray(gap**2 > floor**2 + UNKNOWN_TORQUE**2)


def _fitted_errors(
    arm: CorrectedArm, body: RigidBody, segments: list[Segment], zero: np.ndarray
) -> np.ndarray:
    """Zero, scale and lag of each sensor over their spread, (3 n,), by what an arm leaves of the link side."""
    n = arm.arm.n_joints
    columns, gaps = [], []
    for s in segments:
        link = link_torque(arm, s.bodies(body), s.motion)
        # more rows than twice the band hold nothing new
        step = max(1, int(s.motion.rate / (2 * TORQUE_CUTOFF)))
        rate, kept = s.motion.rate, slice(s.inner.start, s.inner.stop, step)
        x = sensor_errors(link, s.motion.t, zero).reshape(len(link), -1)
        columns.append(low_pass(x, rate, TORQUE_CUTOFF)[kept].reshape(-1, n, 3 * n))
        assert s.torque_sensor is not None
        gaps.append(low_pass(s.torque_sensor - link, rate, TORQUE_CUTOFF)[kept])
    x, gap = np.concatenate(columns), np.vstack(gaps)
    segment = np.repeat(np.arange(len(gaps)), [len(g) for g in gaps])
    out = np.zeros((3, n))
    for j in range(n):
        # zero, scale and lag of one sensor lie n columns apart
        own = x[:, j, j::n]
        left, noise2 = gap[:, j], float((gap[:, j] ** 2).mean())
        # rows count as the noise that is left about what they tell
        for _ in range(2):
            # columns are over the spread of each error: its prior is of unit size
            value = np.linalg.solve(
                own.T @ own / noise2 + np.eye(3), own.T @ left / noise2
            )
            rest = left - own @ value
            inflation = float(variance_inflation(rest[:, None], segment)[0])
            noise2 = max(float((rest**2).mean()) * inflation, MIN_FLOOR**2)
        out[:, j] = value
    return out.ravel()


def _side_gaps(
    arm: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
    readings: list[np.ndarray],
) -> TorqueGap:
    """Gap of the segments with sensors, actuator side of each joint, then link side, (M, 2 n).

    Args:
        arm: that predicts.
        body: dynamics of the nominal arm.
        segments: with sensors.
        readings: what the sensors read without their own errors [N m], (N, n) each.
    """
    measured, predicted, edges = [], [], [0]
    for s, sensor in zip(segments, readings, strict=True):
        assert s.torque is not None
        # Recorded torque less sensor is what rotor and friction took; the sensor is what the link needed.
        laden = s.bodies(body)
        link = link_torque(arm, laden, s.motion)
        needed = arm.unlimited.predict(laden, s.motion)
        recorded = np.hstack([arm.delivered(s.torque, s.motion) - sensor, sensor])
        expected = np.hstack([needed - link, link])
        measured.append(low_pass(recorded, s.motion.rate, TORQUE_CUTOFF)[s.inner])
        predicted.append(low_pass(expected, s.motion.rate, TORQUE_CUTOFF)[s.inner])
        edges.append(edges[-1] + len(measured[-1]))
    return TorqueGap(np.vstack(measured), np.vstack(predicted), tuple(edges))
