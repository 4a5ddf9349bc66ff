"""Where the derivatives of the bodies' torque are taken, and what they need of a segment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.gap.prediction import Prediction
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.diagnosis.thresholds import BACKLASH_START
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.free_play import play_columns
from gapscope.ident.signals.conditioning import Segment


class Bodies:
    """What the columns of a segment need of its bodies whatever the parameters are, each when first asked for.

    Args:
        body: the bodies, with the known load of the segment.
        motion: of the segment, N samples.
        regressor: the inertial regressor on it, shape (N, n, 10 n).

    Attributes:
        last: regressor of the last link, shape (N, n, 10).
    """

    def __init__(self, body: RigidBody, motion: Motion, regressor: np.ndarray) -> None:
        self._body, self._motion = body, motion
        self._torque = regressor @ body.inertial_parameters()
        last = 10 * body.last_link
        self.last = regressor[:, :, last : last + 10].copy()

    @cached_property
    def gravity(self) -> np.ndarray:
        """G with g(q) = G g, shape (N, n, 3); kg m."""
        return self._body.gravity_regressor(self._motion.q)

    @cached_property
    def force(self) -> np.ndarray:
        """J^T of the last link's centre of mass, shape (N, n, 3); m."""
        return self._body.force_regressor(self._motion.q)

    @cached_property
    def play(self) -> np.ndarray:
        """Torque from a little free play on each joint, per radian, shape (N, n, n)."""
        width = BACKLASH_START * self._body.per_radian
        return play_columns(self._body, self._motion, self._torque, width)


@dataclass(frozen=True)
class BodyPoint:
    """Where the derivatives are taken.

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
    def body(self) -> RigidBody:
        """Dynamics of the nominal arm with the segment's known load."""
        return self.at.body

    @property
    def rigid(self) -> np.ndarray:
        """Torque of the bodies at theta [N m], (N, n)."""
        return self.at.rigid

    @property
    def motion(self) -> Motion:
        """The recorded motion."""
        return self.at.motion

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
