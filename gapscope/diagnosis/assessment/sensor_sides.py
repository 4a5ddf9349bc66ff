"""On which side of the joint torque sensors a gap lies: the actuator's, or the link's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.gap.noise_floor import noise_floor
from gapscope.diagnosis.model.linearisation import (
    actuator_floor,
    link_floor,
    link_torque,
    sensor_errors,
)
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    ABOVE_FLOOR_RATIO,
    SENSOR_LAG,
    SENSOR_SCALE,
    SENSOR_ZERO,
)
from gapscope.effects.catalogue import known_effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass
from gapscope.model.torque_gap import (
    TorqueGap,
    filtered_torque,
    torque_scale,
)


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
        """Joints on which the nominal arm's gap is clearly above the floor, (n,)."""
        least = np.maximum(
            ABOVE_FLOOR_RATIO * self.floor, self.floor + ABOVE_FLOOR_NRMSE
        )
        return np.asarray(self.before > least)

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
    predictor: HeldOutPredictor, inertial_error: np.ndarray
) -> SensorSides | None:
    """The gap on both sides on held-out data; ``None`` if what is fitted or what is held out has no sensors.

    The sensors' own errors are fitted to all that may be fitted.

    Args:
        predictor: predicts held-out data with what was found.
        inertial_error: RMS of what errors of the nominal inertials explain, which show on the link side [N m], (n,).
    """
    terms, evidence = predictor.selection.fit.terms, predictor.selection.evidence
    errors = evidence.sensor_errors(terms)
    with_sensor = [s for s in predictor.segments if s.torque_sensor is not None]
    if errors is None or not with_sensor:
        return None

    body = predictor.body
    fitted_arm = predictor.selection.corrected(predictor.selection.fit.theta, terms)
    zero_unit = SENSOR_ZERO * evidence.linear.data.torque_deviation

    def reading_errors(segment: Segment) -> np.ndarray:
        """What zero, scale and lag of the sensors add to their readings [N m], (N, n)."""
        torque = link_torque(fitted_arm, segment.bodies(body), segment.motion)
        return sensor_errors(torque, segment.motion.t, zero_unit) @ errors

    def side_gaps(arm: CorrectedArm, segments: list[Segment]) -> TorqueGap:
        return _side_gaps(arm, body, segments, reading_errors)

    # Both sides have the norm of the recorded torque, so that they can be compared.
    scale = torque_scale(np.vstack([filtered_torque(s) for s in with_sensor]))
    gap_before = predictor.measured(frozenset(), side_gaps)
    gap_after = predictor.measured(terms, side_gaps)
    before = gap_before.rmse.reshape(2, -1) / scale
    after = gap_after.rmse.reshape(2, -1) / scale

    actuator_floors, link_floors = _floors(fitted_arm, body, with_sensor)
    link_floors = np.hypot(link_floors, inertial_error)
    zero, gain, lag = errors.reshape(3, -1)
    return SensorSides(
        actuator=SideGap(before[0], after[0], actuator_floors / scale),
        link=SideGap(before[1], after[1], link_floors / scale),
        zero=zero_unit * zero,
        scale=SENSOR_SCALE * gain,
        lag=SENSOR_LAG * lag,
        recordings=tuple(dict.fromkeys(s.recording for s in with_sensor)),
    )


def _side_gaps(
    arm: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
    reading_errors: Callable[[Segment], np.ndarray],
) -> TorqueGap:
    """Gap of the segments with sensors, actuator side of each joint, then link side, (M, 2 n)."""
    empty: np.ndarray = np.zeros((0, 2 * arm.arm.n_joints))
    measured, predicted, edges = [empty], [empty], [0]
    for s in segments:
        if s.torque is None or s.torque_sensor is None:
            continue

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


def _floors(
    arm: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> tuple[np.ndarray, np.ndarray]:
    """RMS that a healthy arm and its sensors leave, actuator side and link side [N m], (n,) each."""
    actuator, link = [], []
    for segment in segments:
        # Dry friction acts before the sensor: it is not determined on the actuator side alone.
        sticking = noise_floor(arm, body, segment).sticking
        sticking2 = (sticking**2).mean(axis=0)
        steady2 = np.square(actuator_floor(arm, body, segment))
        actuator.append(steady2 + sticking2)
        link.append(np.square(link_floor(arm, body, segment)))
    return np.sqrt(np.mean(actuator, axis=0)), np.sqrt(np.mean(link, axis=0))


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
