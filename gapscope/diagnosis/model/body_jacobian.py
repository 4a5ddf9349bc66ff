"""How the torque of the bodies changes with the linear coordinates of what moves or loads them, on one segment.

These effects change the torque of all joints; their columns follow from the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from gapscope.arm.known_load import point_mass_parameters
from gapscope.diagnosis.gap.prediction import Prediction
from gapscope.diagnosis.model.body_point import Bodies, BodyPoint
from gapscope.diagnosis.model.compliance_columns import Columns, backlash, elasticity
from gapscope.diagnosis.model.terms import Terms
from gapscope.effects.environment import acts, tilt
from gapscope.effects.rigid_body import link_change
from gapscope.effects.transmission import BACKLASH, ELASTICITY
from gapscope.ident.signals.conditioning import Segment


def bodily_columns(
    at: Prediction,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    only: Collection[str] | None = None,
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque at theta, of which ``at`` is the prediction, (N, n), by place in theta.

    ``only`` are the effects whose derivatives are wanted; all if ``None``.
    """
    point = BodyPoint(at, segment, bodies, terms, theta)
    derived = {
        "encoder_offset": _encoder_offset,
        "payload": _payload,
        "base_tilt": _base_tilt,
        "external_force": _external_force,
    }
    # behind encoders on the joints a transmission moves the motors, not the bodies
    if at.arm.arm.encoder == "motor":
        derived |= {ELASTICITY.name: elasticity, BACKLASH.name: backlash}
    out: dict[int, np.ndarray] = {}
    for name, derivatives in derived.items():
        if only is None or name in only:
            out.update(derivatives(point))
    return out


def _encoder_offset(point: BodyPoint) -> Columns:
    """A zero error moves the joint by its negative."""
    by_position = point.sensitivities[0]
    for j, place in enumerate(point.terms.block("encoder_offset")[0]):
        yield int(place), -by_position[:, :, j]


def _payload(point: BodyPoint) -> Columns:
    """A point mass at the last link: its regressor times the derivative of ten inertial parameters."""
    places = point.terms.block("payload")[:, 0]
    regressor, motion = point.bodies.last, point.motion
    # the regressor depends on gravity's direction and on the true positions
    tilted = point.theta[point.terms.block("base_tilt")[:, 0]].any()
    if tilted or point.moved:
        regressor = point.changed.last_link_regressor(point.q, motion.dq, motion.ddq)
    return _by_place(places, regressor @ _payload_tangent(point.theta[places]))


def _base_tilt(point: BodyPoint) -> Columns:
    """G times the derivative of gravity in the base frame."""
    places = point.terms.block("base_tilt")[:, 0]
    regressor = point.bodies.gravity
    if point.arm.inertial_increments(point.body).any() or point.moved:
        regressor = point.changed.gravity_regressor(point.q)
    tangent = _tilt_tangent(point.theta[places], point.arm.arm.gravity)
    return _by_place(places, regressor @ tangent)


def _external_force(point: BodyPoint) -> Columns:
    """A force in its window, if it has one."""
    for term in point.terms.of("external_force"):
        if term in point.terms.shapes:
            start, end = point.terms.shapes[term]
            active = acts(point.motion.t, np.array(start), np.array(end))
            unit_force = point.bodies.force @ point.arm.base_rotation().T
            torque = -active[:, None, None] * unit_force
            yield from _by_place(np.array(term.columns), torque)


def _by_place(places: np.ndarray, derivatives: np.ndarray) -> Columns:
    """Derivatives (N, n, C) by their places, (C,)."""
    for i, place in enumerate(places):
        yield int(place), derivatives[:, :, i]


def _payload_tangent(payload: np.ndarray) -> np.ndarray:
    """Derivative of the payload's ten inertial parameters by mass and first moment, shape (10, 4)."""
    mass = payload[0]
    if abs(mass) < 1e-3:
        return np.eye(10, 4)
    return _central(
        lambda p: point_mass_parameters(p[0], p[1:] / p[0]), payload, 1e-4 * abs(mass)
    )


def link_tangent(own: np.ndarray, link: int, change: np.ndarray) -> np.ndarray:
    """Derivative of a link's ten inertial parameters by its increments of mass and centre, shape (10, 4)."""
    return _central(
        lambda x: link_change(own, np.array(link), x[0], x[1:]), change, 1e-5
    )


def _tilt_tangent(angles: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Derivative of gravity in the base frame, R^T g, by roll and pitch [m/s^2/rad], shape (3, 2)."""
    return _central(lambda a: tilt(a[0], a[1]).T @ np.asarray(gravity), angles, 1e-5)


def _central(function, at: np.ndarray, step: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    steps = step * np.eye(len(at))
    return np.stack(
        [(function(at + s) - function(at - s)) / (2 * step) for s in steps], axis=1
    )
