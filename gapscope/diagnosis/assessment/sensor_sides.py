"""On which side of the joint torque sensors a gap lies: the actuator's, or the link's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.gap.torque_gap import (
    TorqueGap,
    filtered_torque,
    noise_floor,
    torque_scale,
)
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.model.torque_sensor import (
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
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF, Segment, low_pass


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

    def above(self, values: np.ndarray) -> np.ndarray:
        """Joints on which ``values`` stand clearly above the floor, (n,)."""
        return values > np.maximum(
            ABOVE_FLOOR_RATIO * self.floor, self.floor + ABOVE_FLOOR_NRMSE
        )


@dataclass(frozen=True)
class Sides:
    """The gap on both sides of the sensors, and what the sensors themselves seem to have wrong.

    Attributes:
        actuator: of recorded torque less sensor, against rotor, friction and all on the way to the gear.
        link: of the sensor, against the bodies and what acts on them.
        zero, scale, lag: errors of the sensors [N m], [1], [s], (n,); taken out of both gaps.
        recordings: those with sensors, on which the gaps were told.
    """

    actuator: SideGap
    link: SideGap
    zero: np.ndarray
    scale: np.ndarray
    lag: np.ndarray
    recordings: tuple[str, ...]


def find_sides(predictor: HeldOutPredictor, nominal: np.ndarray) -> Sides | None:
    """The gap on both sides on unseen data; ``None`` where what is fitted or what is judged has no sensors.

    The sensors' own errors are fitted to all that may be fitted.

    Args:
        judge: predicts unseen data with what was found.
        nominal: RMS of what errors of the nominal inertials explain, which show on the link side [N m], (n,).
    """
    terms, evidence = predictor.selection.fit.terms, predictor.selection.evidence
    errors = evidence.sensor_errors(terms)
    told = [s for s in predictor.segments if s.torque_sensor is not None]
    if errors is None or not told:
        return None
    zero = SENSOR_ZERO * evidence.linear.data.torque_deviation
    arm = CorrectedArm(
        predictor.arm, evidence.terms.effects(predictor.selection.fit.theta, terms)
    )

    def gap(other: CorrectedArm, segments: list[Segment]) -> TorqueGap:
        return _gap(
            other,
            predictor.body,
            segments,
            lambda s: _reading_errors(arm, predictor.body, s, zero, errors),
        )

    scale = torque_scale(np.vstack([filtered_torque(s) for s in told]))
    before, after = (
        predictor.measured(stage, gap).rmse.reshape(2, -1) / scale
        for stage in (frozenset[Term](), terms)
    )
    own, links = _floors(arm, predictor.body, told)
    floors = own / scale, np.hypot(links, nominal) / scale
    actuator, link = (
        SideGap(*side) for side in zip(before, after, floors, strict=True)
    )
    wrong = errors.reshape(3, -1)
    names = tuple(dict.fromkeys(s.recording for s in told))
    return Sides(
        actuator,
        link,
        zero * wrong[0],
        SENSOR_SCALE * wrong[1],
        SENSOR_LAG * wrong[2],
        names,
    )


def _reading_errors(
    arm: CorrectedArm,
    body: RigidBody,
    segment: Segment,
    zero: np.ndarray,
    errors: np.ndarray,
) -> np.ndarray:
    """What zero, scale and lag of the sensors add to their readings [N m], (N, n)."""
    return (
        sensor_errors(
            link_torque(arm, segment.bodies(body), segment.motion),
            segment.motion.t,
            zero,
        )
        @ errors
    )


def _gap(
    arm: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
    errors: Callable[[Segment], np.ndarray],
) -> TorqueGap:
    """Gap of the segments with sensors, actuator side of each joint, then link side, (M, 2 n)."""
    none = np.zeros((0, 2 * arm.arm.n_joints))
    measured, predicted, edges = none, none, [0]
    for s in segments:
        if s.torque is None or s.torque_sensor is None:
            continue
        laden = s.bodies(body)
        sensor, link = s.torque_sensor - errors(s), link_torque(arm, laden, s.motion)
        told = np.hstack([arm.delivered(s.torque) - sensor, sensor])
        own = np.hstack([arm.unlimited.predict(laden, s.motion) - link, link])
        told, own = (
            low_pass(x, s.motion.rate, TORQUE_CUTOFF)[s.inner] for x in (told, own)
        )
        measured, predicted = np.vstack([measured, told]), np.vstack([predicted, own])
        edges.append(len(measured))
    return TorqueGap(measured, predicted, tuple(edges))


def _floors(
    arm: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> tuple[np.ndarray, np.ndarray]:
    """RMS that a healthy arm and its sensors leave, actuator side and link side [N m], (n,) each."""
    actuator = [
        np.square(actuator_floor(arm, body, s))
        + (noise_floor(arm, body, s).sticking ** 2).mean(axis=0)
        for s in segments
    ]
    link = [np.square(link_floor(arm, body, s)) for s in segments]
    return np.sqrt(np.mean(actuator, axis=0)), np.sqrt(np.mean(link, axis=0))


def described(sides: Sides, found: list[dict[str, Any]]) -> dict[str, Any]:
    """``sides`` of ``diagnosis.json``.

    Args:
        sides: the gaps.
        found: findings of the document.
    """
    n = len(sides.zero)
    before = {
        name: getattr(sides, name).above(getattr(sides, name).before)
        for name in ("actuator", "link")
    }
    carried = [
        " and ".join(name for name, joints in before.items() if joints[j]) or "neither"
        for j in range(n)
    ]
    return {
        **{name: _side(getattr(sides, name)) for name in ("actuator", "link")},
        "carried_by": ["both" if c == "actuator and link" else c for c in carried],
        "sensor": {
            "zero": {"unit": "N m", "value": sides.zero.tolist()},
            "scale": {"unit": "1", "value": sides.scale.tolist()},
            "lag": {"unit": "s", "value": sides.lag.tolist()},
        },
        "recordings": list(sides.recordings),
        "effects": [
            {
                "effect": f["effect"],
                "joints": f["joints"],
                "side": CATALOGUE[f["effect"]].side,
            }
            for f in found
            if f["effect"] in CATALOGUE
        ],
    }


def _side(gap: SideGap) -> dict[str, Any]:
    return {
        "before": {"torque_nrmse": gap.before.tolist(), "floor": gap.floor.tolist()},
        "after": {"torque_nrmse": gap.after.tolist()},
    }
