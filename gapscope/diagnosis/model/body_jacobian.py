"""How the torque of the bodies changes with the linear coordinates of what moves or loads them, on one segment.

These effects change the torque of all joints; their columns follow from the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import point_mass_parameters
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.model.terms import Term, Terms, parametrisation_of
from gapscope.diagnosis.thresholds import BACKLASH_START, PLAY_STEP
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm, slow_with_rates
from gapscope.effects.environment import acts, tilt
from gapscope.effects.free_play import play_columns
from gapscope.effects.rigid_body import link_change
from gapscope.ident.signals.conditioning import Segment

DERIVED = (
    "payload",
    "link_inertia",
    "base_tilt",
    "external_force",
    "encoder_offset",
    "joint_elasticity",
    "backlash",
)
"""Effects that reach other joints and whose columns are derived here; those of others are finite differences."""


Columns = Iterator[tuple[int, np.ndarray]]
"""Places in theta with their derivatives, (N, n)."""


@dataclass(frozen=True)
class Bodies:
    """What the columns of a segment need of its bodies whatever the parameters are, N samples.

    Attributes:
        gravity: G with g(q) = G g, shape (N, n, 3); kg m.
        force: J^T of the last link's centre of mass, shape (N, n, 3); m.
        last: regressor of the last link, shape (N, n, 10).
        play: torque from a little free play on each joint, per radian, shape (N, n, n).
    """

    gravity: np.ndarray
    force: np.ndarray
    last: np.ndarray
    play: np.ndarray

    @classmethod
    def of(cls, body: RigidBody, segment: Segment, regressor: np.ndarray) -> Bodies:
        """The bodies of a segment, its known load included, with its inertial regressor, shape (N, n, 10 n)."""
        motion, last = segment.motion, 10 * body.last_link
        torque = regressor @ body.inertial_parameters()
        return cls(
            body.gravity_regressor(motion.q),
            body.force_regressor(motion.q),
            regressor[:, :, last : last + 10].copy(),
            play_columns(body, motion, torque, BACKLASH_START * body.per_radian),
        )


@dataclass(frozen=True)
class _Point:
    """Where the derivatives are taken.

    Attributes:
        arm: the arm with the effects of theta, without limits.
        body: dynamics of the nominal arm with the segment's known load.
        segment: the segment.
        bodies: what does not depend on theta.
        terms: all terms, with the nonlinear parameters of those that have some.
        theta: linear coordinates, shape (P,).
        rigid: torque of the bodies at theta [N m], (N, n).
    """

    arm: CorrectedArm
    body: RigidBody
    segment: Segment
    bodies: Bodies
    terms: Terms
    theta: np.ndarray
    rigid: np.ndarray

    @property
    def motion(self) -> Motion:
        """The recorded motion."""
        return self.segment.motion

    @cached_property
    def q(self) -> np.ndarray:
        """True positions [rad], (N, n)."""
        return self.arm.true_position(self.motion.q)

    @cached_property
    def moved(self) -> bool:
        """Whether the true positions are not the recorded ones."""
        return bool((self.q != self.motion.q).any())

    @cached_property
    def changed(self) -> RigidBody:
        """The bodies with the effects of theta."""
        return self.arm.body(self.body)

    @cached_property
    def sensitivities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of the bodies' torque by position, velocity and acceleration, (N, n, n) each."""
        return self.changed.sensitivities(self.q, self.motion.dq, self.motion.ddq)

    def in_use(self, term: Term) -> bool:
        """Whether a term's values are not zero."""
        return bool(self.theta[list(term.columns)].any())

    def rigid_with(self, effect: str, place: int, step: float) -> np.ndarray:
        """Torque of the bodies with one coordinate of an effect moved by a step [N m], (N, n)."""
        moved = self.theta.copy()
        moved[place] += step
        mine = [t for t in self.terms.of(effect) if moved[list(t.columns)].any()]
        others = tuple(e for e in self.arm.effects if e.name != effect)
        arm = replace(self.arm, effects=(*others, *self.terms.effects(moved, mine)))
        return arm.rigid_torque(self.body, self.motion)


def bodily_columns(
    arm: CorrectedArm,
    body: RigidBody,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    rigid: np.ndarray,
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque, (N, n), by place in theta; ``body`` carries the segment's known load."""
    point = _Point(arm, body, segment, bodies, terms, theta, rigid)
    out = dict(_encoder_offset(point))
    out.update(_payload(point))
    out.update(_base_tilt(point))
    out.update(forced_columns(arm, segment, bodies, terms))
    out.update(_other_effects(point))
    # behind encoders on the joints a transmission moves the motors, not the bodies
    if arm.arm.encoder == "motor":
        out.update(_elasticity(point))
        out.update(_backlash(point))
        out.update(_compliance_in_use(point))
    return out


def _encoder_offset(point: _Point) -> Columns:
    """A zero error moves the joint by its negative."""
    by_position = point.sensitivities[0]
    for j, place in enumerate(point.terms.block("encoder_offset")[0]):
        yield int(place), -by_position[:, :, j]


def _payload(point: _Point) -> Columns:
    """A point mass at the last link: its regressor times the derivative of ten inertial parameters."""
    places = point.terms.block("payload")[:, 0]
    regressor, motion = point.bodies.last, point.motion
    # the regressor depends on gravity's direction and on the true positions
    tilted = point.theta[point.terms.block("base_tilt")[:, 0]].any()
    if tilted or point.moved:
        regressor = point.changed.last_link_regressor(point.q, motion.dq, motion.ddq)
    return _by_place(places, regressor @ _payload_tangent(point.theta[places]))


def _base_tilt(point: _Point) -> Columns:
    """G times the derivative of gravity in the base frame."""
    places = point.terms.block("base_tilt")[:, 0]
    regressor = point.bodies.gravity
    if point.arm.inertial_increments(point.body).any() or point.moved:
        regressor = point.changed.gravity_regressor(point.q)
    tangent = _tilt_tangent(point.theta[places], point.arm.arm.gravity)
    return _by_place(places, regressor @ tangent)


def forced_columns(
    arm: CorrectedArm, segment: Segment, bodies: Bodies, terms: Terms
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque by the force from outside, (N, n), by place in theta."""
    out: dict[int, np.ndarray] = {}
    for term in terms.of("external_force"):
        if term in terms.shapes:
            start, end = terms.shapes[term]
            active = acts(segment.motion.t, np.array(start), np.array(end))
            unit_force = bodies.force @ arm.base_rotation().T
            torque = -active[:, None, None] * unit_force
            out.update(_by_place(np.array(term.columns), torque))
    return out


def _other_effects(point: _Point) -> Columns:
    """Finite differences for effects that reach other joints and have no derivative here."""
    for effect in explained():
        if effect.reach != "arm" or effect.name in DERIVED:
            continue
        step, available = parametrisation_of(effect).step, point.terms.open
        for term in point.terms.of(effect.name):
            for place in term.columns if term in available else ():
                moved = point.rigid_with(effect.name, place, step)
                yield place, (moved - point.rigid) / step


def _elasticity(point: _Point) -> Columns:
    """A joint that bends by torque times compliance, less damping times its rate, moves its link as slowly."""
    motion = point.motion
    twist = _transmitted(point.arm, point.segment)
    per_coordinate = (twist, -np.gradient(twist, motion.t, axis=0))
    blocks = point.terms.block("joint_elasticity")
    for unit, places in zip(per_coordinate, blocks, strict=True):
        deflections = slow_with_rates(unit, motion)
        for j, place in enumerate(places):
            torque = [
                matrix[:, :, j] * x[:, j, None]
                for matrix, x in zip(point.sensitivities, deflections, strict=True)
            ]
            yield int(place), -sum(torque, np.zeros(1))


def _backlash(point: _Point) -> Columns:
    """Free play as it begins."""
    for j, place in enumerate(point.terms.block("backlash")[0]):
        yield int(place), point.bodies.play[:, :, j]


def _compliance_in_use(point: _Point) -> Columns:
    """Around values that are not zero elasticity and backlash have other columns than where they begin."""
    largest = np.abs(point.theta[point.terms.block("joint_elasticity")[0]]).max()
    for term in point.terms.of("joint_elasticity"):
        for place in term.columns if point.in_use(term) else ():
            step = 1e-3 * max(abs(point.theta[place]), 1e-3 * largest)
            moved = point.rigid_with("joint_elasticity", place, step)
            yield place, (moved - point.rigid) / step
    for term in point.terms.of("backlash"):
        for place in term.columns if point.in_use(term) else ():
            step = PLAY_STEP * abs(point.theta[place])
            above = point.rigid_with("backlash", place, step)
            below = point.rigid_with("backlash", place, -step)
            yield place, (above - below) / (2 * step)


def _transmitted(arm: CorrectedArm, segment: Segment) -> np.ndarray:
    """Torque through the transmission as recorded [N m], (N, n): what reached the motors less what they need."""
    assert segment.torque is not None
    bare = replace(
        arm,
        effects=tuple(
            e for e in arm.effects if e.effect.family in ("friction", "rigid_body")
        ),
    )
    scale = 1.0 + arm.value("torque_scale", "scale")
    return scale * arm.delivered(segment.torque) - bare.needed_torque(
        np.zeros_like(segment.torque), segment.motion
    )


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
