"""On which side of the joint torque sensors a gap lies: the actuator's, or the link's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.assessment.unknown import unknown
from gapscope.diagnosis.locate import stack
from gapscope.diagnosis.thresholds import (
    MIN_FLOOR,
    SENSOR_LAG,
    SENSOR_SCALE,
    SENSOR_ZERO,
    UNKNOWN_TORQUE,
)
from gapscope.effects.catalogue import known_effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass, torque_scale
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


@dataclass(frozen=True)
class SideGap:
    """Gap on one side of the sensors, in the norm of ``torque_nrmse`` of the recorded torque; each of shape (n,).

    Attributes:
        before, after: of the nominal arm, and with the effects found.
        floor: what a healthy arm and its sensors leave.
    """

    before: np.ndarray
    after: np.ndarray
    floor: np.ndarray

    @property
    def carries(self) -> np.ndarray:
        """Joints on which the nominal arm's gap is above the floor by what is worth a search, (n,)."""
        return np.asarray(self.before**2 > self.floor**2 + UNKNOWN_TORQUE**2)

    def entry(self) -> dict[str, Any]:
        """The entry in ``diagnosis.json``."""
        before, after, floor = (
            x.tolist() for x in (self.before, self.after, self.floor)
        )
        return {
            "before": {"torque_nrmse": before, "floor": floor},
            "after": {"torque_nrmse": after},
        }


@dataclass(frozen=True)
class SensorSides:
    """The gap on both sides of the sensors, and what the sensors themselves seem to have wrong.

    Attributes:
        actuator: of recorded torque less sensor, against rotor, friction and all on the way to the gear.
        link: of the sensor, against the bodies and what acts on them.
        zero, scale, lag: errors of the sensors [N m], [1], [s], (n,); taken out of both gaps.
        recordings: those with sensors, on which the gaps were measured.
    """

    actuator: SideGap
    link: SideGap
    zero: np.ndarray
    scale: np.ndarray
    lag: np.ndarray
    recordings: tuple[str, ...]

    @property
    def carried_by(self) -> list[str]:
        """Side that carries the gap of each joint: ``actuator``, ``link``, ``both`` or ``neither``."""
        names = {
            (True, True): "both",
            (True, False): "actuator",
            (False, True): "link",
            (False, False): "neither",
        }
        carries = zip(self.actuator.carries, self.link.carries, strict=True)
        return [names[bool(actuator), bool(link)] for actuator, link in carries]


def find_sides(
    nominal: CorrectedArm,
    corrected: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
) -> SensorSides | None:
    """The gap on both sides; ``None`` if no segment has sensors.

    The sensors' own errors are fitted to what the corrected arm leaves on the link side.

    Args:
        nominal, corrected: the arm of the data sheet, and with the effects found.
        body: dynamics of the nominal arm.
        segments: on which gaps are measured.
    """
    with_sensor = [s for s in segments if s.torque_sensor is not None]
    if not with_sensor:
        return None
    # Both sides have the norm of the recorded torque, so that they can be compared.
    scale = torque_scale(np.vstack([filtered_torque(s) for s in with_sensor]))
    zero_unit = SENSOR_ZERO * scale
    errors = _fitted_errors(corrected, body, with_sensor, zero_unit)

    def reading_errors(segment: Segment) -> np.ndarray:
        """What zero, scale and lag of the sensors add to their readings [N m], (N, n)."""
        torque = link_torque(corrected, segment.bodies(body), segment.motion)
        return sensor_errors(torque, segment.motion.t, zero_unit) @ errors

    before, after = (
        _side_gaps(arm, body, with_sensor, reading_errors)
        for arm in (nominal, corrected)
    )
    rows, sides = stack(with_sensor), []
    for own in (slice(0, len(scale)), slice(len(scale), None)):
        gap = TorqueGap(after.measured[:, own], after.predicted[:, own], after.edges)
        found = unknown(gap, rows, np.ones_like(gap.error), scale)
        left2 = gap.rmse**2 - found.follows2
        each = before.rmse[own], gap.rmse, np.sqrt(np.maximum(left2, MIN_FLOOR**2))
        sides.append(SideGap(*(x / scale for x in each)))
    zero, gain, lag = errors.reshape(3, -1)
    return SensorSides(
        actuator=sides[0],
        link=sides[1],
        zero=zero_unit * zero,
        scale=SENSOR_SCALE * gain,
        lag=SENSOR_LAG * lag,
        recordings=tuple(dict.fromkeys(s.recording for s in with_sensor)),
    )


def _fitted_errors(
    arm: CorrectedArm, body: RigidBody, segments: list[Segment], zero: np.ndarray
) -> np.ndarray:
    """Zero, scale and lag of each sensor over their spread, (3 n,), by what an arm leaves of the link side."""
    n = arm.arm.n_joints
    columns, gaps = [], []
    for s in segments:
        link = link_torque(arm, s.bodies(body), s.motion)
        rate, kept = s.motion.rate, slice(s.inner.start, s.inner.stop, _step(s))
        x = sensor_errors(link, s.motion.t, zero).reshape(len(link), -1)
        columns.append(low_pass(x, rate, TORQUE_CUTOFF)[kept].reshape(-1, n, 3 * n))
        assert s.torque_sensor is not None
        gaps.append(low_pass(s.torque_sensor - link, rate, TORQUE_CUTOFF)[kept])
    x, gap = np.concatenate(columns), np.vstack(gaps)
    segment = np.repeat(np.arange(len(gaps)), [len(g) for g in gaps])
    out = np.zeros((3, n))
    for j in range(n):
        own = x[:, j, j::n]
        left, noise2 = gap[:, j], float((gap[:, j] ** 2).mean())
        # rows count as the noise that is left about what they tell
        for _ in range(2):
            value = np.linalg.solve(
                own.T @ own / noise2 + np.eye(3), own.T @ left / noise2
            )
            rest = left - own @ value
            inflation = float(variance_inflation(rest[:, None], segment)[0])
            noise2 = max(float((rest**2).mean()) * inflation, MIN_FLOOR**2)
        out[:, j] = value
    return out.ravel()


def _step(segment: Segment) -> int:
    """Every how many samples a segment is read for the errors of its sensors: twice the filter's cut-off."""
    return max(1, int(segment.motion.rate // (2.5 * TORQUE_CUTOFF)))


def _side_gaps(
    arm: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
    reading_errors: Callable[[Segment], np.ndarray],
) -> TorqueGap:
    """Gap of the segments with sensors, actuator side of each joint, then link side, (M, 2 n)."""
    measured, predicted, edges = [], [], [0]
    for s in segments:
        assert s.torque is not None and s.torque_sensor is not None
        # Recorded torque less sensor is what rotor and friction took; the sensor is what the link needed.
        laden = s.bodies(body)
        sensor = s.torque_sensor - reading_errors(s)
        link = link_torque(arm, laden, s.motion)
        needed = arm.unlimited.predict(laden, s.motion)
        recorded = np.hstack([arm.delivered(s.torque) - sensor, sensor])
        expected = np.hstack([needed - link, link])

        measured.append(low_pass(recorded, s.motion.rate, TORQUE_CUTOFF)[s.inner])
        predicted.append(low_pass(expected, s.motion.rate, TORQUE_CUTOFF)[s.inner])
        edges.append(edges[-1] + len(measured[-1]))
    return TorqueGap(np.vstack(measured), np.vstack(predicted), tuple(edges))


def sides_entry(sides: SensorSides, found: list[dict[str, Any]]) -> dict[str, Any]:
    """``sides`` of ``diagnosis.json``.

    Args:
        sides: the gaps.
        found: findings of the document.
    """
    return {
        "actuator": sides.actuator.entry(),
        "link": sides.link.entry(),
        "carried_by": sides.carried_by,
        "sensor": {
            "zero": {"unit": "N m", "value": sides.zero.tolist()},
            "scale": {"unit": "1", "value": sides.scale.tolist()},
            "lag": {"unit": "s", "value": sides.lag.tolist()},
        },
        "recordings": list(sides.recordings),
        "effects": [
            {
                "effect": finding["effect"],
                "joints": finding["joints"],
                "side": definition.side,
            }
            for finding in found
            for definition in [known_effect(finding["effect"])]
            if definition is not None
        ],
    }
