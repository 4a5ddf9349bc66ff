"""The bodies of an arm with effects on one segment: ``gapscope.effects.effect.Mechanics``, each part when asked for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import play_columns
from gapscope.effects.effect import Effect, LinkChange, Transmission
from gapscope.model.conditioning import Segment
from gapscope.model.prediction import Prediction
from gapscope.model.terms import Terms


class Bodies:
    """What the columns of a segment need of its bodies whatever the parameters are, each when first asked for.

    Args:
        body: the bodies, with the known load of the segment.
        motion: of the segment, N samples.
        regressor: the inertial regressor on it, shape (N, n, 10 n); ``None``: when it is asked for.
    """

    def __init__(
        self, body: RigidBody, motion: Motion, regressor: np.ndarray | None = None
    ) -> None:
        self._body, self._motion = body, motion
        self._play: dict[float, np.ndarray] = {}
        if regressor is not None:
            self._both = self._of(regressor)

    def _of(self, regressor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        last = 10 * self._body.last_link
        torque = regressor @ self._body.inertial_parameters()
        return torque, regressor[:, :, last : last + 10].copy()

    @cached_property
    def _both(self) -> tuple[np.ndarray, np.ndarray]:
        """Torque of the bodies, shape (N, n), and regressor of the last link, shape (N, n, 10)."""
        m = self._motion
        return self._of(self._body.regressor(m.q, m.dq, m.ddq))

    @property
    def last(self) -> np.ndarray:
        """Regressor of the last link, shape (N, n, 10)."""
        return self._both[1]

    @cached_property
    def gravity(self) -> np.ndarray:
        """G with g(q) = G g, shape (N, n, 3); kg m."""
        return self._body.gravity_regressor(self._motion.q)

    @cached_property
    def force(self) -> np.ndarray:
        """J^T of the last link's centre of mass, shape (N, n, 3); m."""
        return self._body.force_regressor(self._motion.q)

    def play(self, width: float) -> np.ndarray:
        """Torque per radian from free play [rad] on each joint, shape (N, n, n)."""
        if width not in self._play:
            widths = width * self._body.per_radian
            self._play[width] = play_columns(
                self._body, self._motion, self._both[0], widths
            )
        return self._play[width]


@dataclass(frozen=True)
class LinearisationPoint:
    """Where the derivatives are taken: ``Mechanics`` of a segment.

    Attributes:
        at: what the arm with the effects of theta predicts.
        segment: the segment.
        bodies: what does not depend on theta.
        terms: all terms, with the nonlinear parameters of those that have some.
        theta: linear coordinates, shape (P,).
    """

    at: Prediction
    segment: Segment
    bodies: Bodies
    terms: Terms
    theta: np.ndarray

    @property
    def arm(self) -> CorrectedArm:
        """The arm with the effects of theta, without limits."""
        return self.at.arm

    @property
    def rigid(self) -> np.ndarray:
        """Torque of the bodies at theta [N m], (N, n)."""
        return self.at.rigid

    @property
    def motion(self) -> Motion:
        """The recorded motion."""
        return self.at.motion

    @property
    def gravity(self) -> np.ndarray:
        """Nominal gravity [m/s^2], (3,)."""
        return np.asarray(self.arm.arm.gravity)

    @property
    def inertials(self) -> np.ndarray:
        """Ten nominal inertial parameters of each link, (n, 10)."""
        return self.at.body.inertial_parameters().reshape(-1, 10)

    @property
    def last_link(self) -> int:
        """Number of the last link, from 0."""
        return self.at.body.last_link

    @cached_property
    def q(self) -> np.ndarray:
        """True positions [rad], (N, n)."""
        return self.arm.true_position(self.motion.q)

    @cached_property
    def _moved(self) -> bool:
        """Whether the true positions are not the recorded ones."""
        return bool((self.q != self.motion.q).any())

    @cached_property
    def _changed(self) -> RigidBody:
        """The bodies with the effects of theta."""
        return self.arm.body(self.at.body)

    @cached_property
    def sensitivities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of the bodies' torque by position, velocity and acceleration, (N, n, n) each."""
        return self._changed.sensitivities(self.q, self.motion.dq, self.motion.ddq)

    @cached_property
    def gravity_regressor(self) -> np.ndarray:
        """G with G g the torque of gravity, (N, n, 3) [kg m]."""
        changed = self.arm.inertial_increments(self.at.body).any()
        if changed or self._moved:
            return self._changed.gravity_regressor(self.q)
        return self.bodies.gravity

    @property
    def unit_force(self) -> np.ndarray:
        """J^T by a force in the world frame at the last link's centre of mass, (N, n, 3) [m]."""
        return self.bodies.force @ self.arm.base_rotation().T

    def link_regressor(self, link: int) -> np.ndarray:
        """The bodies' torque by the inertial parameters of a link, (N, n, 10)."""
        # it depends on gravity's direction and on the true positions
        as_nominal = np.array_equal(self.arm.base_rotation(), np.eye(3))
        if link == self.last_link and as_nominal and not self._moved:
            return self.bodies.last
        motion = self.motion
        return self._changed.link_regressor(link, self.q, motion.dq, motion.ddq)

    @cached_property
    def transmitted(self) -> np.ndarray:
        """Torque through the transmissions as recorded [N m], (N, n): what reached the motors less what they need."""
        recorded = self.segment.torque
        assert recorded is not None
        # friction and rotors take from the motor, springs and bodies from the link
        of_motors = [
            e for e in self.arm.effects if e.effect.family in ("friction", "rigid_body")
        ]
        bare = replace(self.arm, effects=tuple(of_motors))
        scale = 1.0 + self.arm.quantity("scale")
        needed = bare.needed_torque(np.zeros_like(recorded), self.motion)
        return np.asarray(scale * self.arm.delivered(recorded) - needed)

    def value(self, effect: str, parameter: str) -> np.ndarray:
        """Values of an effect's parameter over all joints, (n,)."""
        return self.arm.value(effect, parameter)

    def nominal_play(self, width: float) -> np.ndarray:
        """Torque per radian from free play [rad] on each nominal joint, (N, n, n)."""
        return self.bodies.play(width)

    def rigid_with(self, effect: Effect, x: np.ndarray) -> np.ndarray:
        """Torque of the bodies with an effect at other linear coordinates, (linear, m) [N m], (N, n)."""
        moved = self.theta.copy()
        chosen = [t for t in self.terms.of(effect.name) if self.terms.can_choose(t)]
        for term, own in zip(chosen, x.T, strict=True):
            moved[list(term.columns)] = own
        mine = [t for t in chosen if moved[list(t.columns)].any()]
        others = tuple(e for e in self.arm.effects if e.name != effect.name)
        arm = replace(self.arm, effects=(*others, *self.terms.effects(moved, mine)))
        return arm.rigid_torque(self.at.body, self.motion)


def acts_on_bodies(effect: Effect, arm: CorrectedArm) -> bool:
    """Whether an effect changes the torque of all joints by way of their bodies."""
    # behind encoders on the joints a transmission moves the motors, not the links
    behind = isinstance(effect, Transmission) and arm.arm.encoder == "joint"
    return effect.reach == "arm" and not behind


def rigid_body_jacobian(
    at: Prediction,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    only: Collection[str] | None = None,
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque at theta, of which ``at`` is the prediction, (N, n), by place in theta.

    Those of changed links are left out: they are combinations of the inertial regressor, which is kept. ``only`` are
    the effects whose derivatives are wanted; all if ``None``.
    """
    point = LinearisationPoint(at, segment, bodies, terms, theta)
    out: dict[int, np.ndarray] = {}
    for effect in terms.definitions:
        of_links = isinstance(effect, LinkChange) and effect.scope == "link"
        unwanted = only is not None and effect.name not in only
        chosen = [t for t in terms.of(effect.name) if terms.can_choose(t)]
        if of_links or unwanted or not chosen or not acts_on_bodies(effect, at.arm):
            continue
        places = np.array([t.columns for t in chosen]).T
        searched = np.array([terms.shapes.get(t, ()) for t in chosen]).T
        columns = effect.columns(point, theta[places], searched)
        for i, j in np.ndindex(*places.shape):
            out[int(places[i, j])] = columns[:, :, i, j]
    return out
