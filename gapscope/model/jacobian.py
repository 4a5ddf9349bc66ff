"""How the recorded torque changes with the linear coordinates of every term, on the rows of one segment.

Most effects on a joint change the torque of that joint alone; their columns are finite differences of the corrected
arm. What moves or loads the bodies changes the torque of all joints, by the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import play_columns
from gapscope.effects.effect import Effect, LinkChange, Path, TorqueLaw, Transmission
from gapscope.effects.signals import Moment
from gapscope.model.conditioning import Segment
from gapscope.model.rows import DecimatedSegments
from gapscope.model.terms import Term, Terms

TORQUE_STEP = 1e-4
"""Step of coordinates that go with a torque, over the joint's own [1]: friction that depends on the load is no linear
function of the others, and fingers have a ten-thousandth of the torque of a shoulder."""
MIN_TORQUE = 1e-3
"""A joint's torque is taken as no less than this share of the largest [1]."""
MAX_TORQUE_GAIN = 5.0
"""Recorded over needed torque, and its inverse, at most [1]: a wider finite difference crosses a reversal of friction.
"""
MAX_NUMBERS = 2_000_000
"""Numbers up to which the torques of moved arms are held at once, so that a long segment costs no more memory."""


class Bodies:
    """What the columns of a segment need of its bodies whatever the parameters are, each when first asked for.

    Args:
        nominal: the bodies without the known load of the segment.
        segment: of N samples.

    Attributes:
        body: the bodies with that load.
    """

    def __init__(self, nominal: RigidBody, segment: Segment) -> None:
        self.body, self.segment = segment.bodies(nominal), segment
        self._play: dict[float, np.ndarray] = {}

    def regressor(self) -> np.ndarray:
        """Inertial regressor of the motion, (N, n, 10 n)."""
        motion = self.segment.motion
        return self.body.regressor(motion.q, motion.dq, motion.ddq)

    @cached_property
    def force(self) -> np.ndarray:
        """J^T of the last link's centre of mass, shape (N, n, 3); m."""
        return self.body.force_regressor(self.segment.motion.q)

    def play(self, width: float) -> np.ndarray:
        """Torque per radian from free play [rad] on each joint, shape (N, n, n)."""
        if width not in self._play:
            widths, motion = width * self.body.per_radian, self.segment.motion
            torque = self.body.inverse_dynamics(motion.q, motion.dq, motion.ddq)
            self._play[width] = play_columns(self.body, motion, torque, widths)
        return self._play[width]


@dataclass(frozen=True)
class LinearisationPoint:
    """Where derivatives are taken: ``gapscope.effects.effect.Mechanics`` of a segment of N samples.

    Attributes:
        arm: the arm with the effects of theta, without limits.
        bodies: what does not depend on theta.
        terms: all terms, with the nonlinear parameters of those that have some.
        theta: linear coordinates, shape (P,).
        rigid: torque of the bodies [N m], (N, n).
        torque: that would be recorded, limits aside [N m], (N, n).
    """

    arm: CorrectedArm
    bodies: Bodies
    terms: Terms
    theta: np.ndarray
    rigid: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(
        cls, corrected: CorrectedArm, bodies: Bodies, terms: Terms, theta: np.ndarray
    ) -> LinearisationPoint:
        """The point of an arm that has the effects of theta."""
        arm, motion = corrected.unlimited, bodies.segment.motion
        rigid = arm.rigid_torque(bodies.body, motion)
        torque = arm.recorded_torque(arm.needed_torque(rigid, motion), motion)
        return cls(arm, bodies, terms, theta, rigid, torque)

    @property
    def motion(self) -> Motion:
        """The recorded motion."""
        return self.bodies.segment.motion

    @property
    def gravity(self) -> np.ndarray:
        """Nominal gravity [m/s^2], (3,)."""
        return np.asarray(self.arm.arm.gravity)

    @property
    def inertials(self) -> np.ndarray:
        """Ten nominal inertial parameters of each link, (n, 10)."""
        return self.bodies.body.inertial_parameters().reshape(-1, 10)

    @property
    def last_link(self) -> int:
        """Number of the last link, from 0."""
        return self.bodies.body.last_link

    @cached_property
    def q(self) -> np.ndarray:
        """True positions [rad], (N, n)."""
        return self.arm.true_position(self.motion.q)

    @cached_property
    def _changed(self) -> RigidBody:
        """The bodies with the effects of theta."""
        return self.arm.body(self.bodies.body)

    @cached_property
    def sensitivities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of the bodies' torque by position, velocity and acceleration, (N, n, n) each."""
        return self._changed.sensitivities(self.q, self.motion.dq, self.motion.ddq)

    @cached_property
    def gravity_regressor(self) -> np.ndarray:
        """G with G g the torque of gravity, (N, n, 3) [kg m]."""
        return self._changed.gravity_regressor(self.q)

    @property
    def unit_force(self) -> np.ndarray:
        """J^T by a force in the world frame at the last link's centre of mass, (N, n, 3) [m]."""
        # the force is in the world frame, the bodies count in that of the base
        return self.bodies.force @ self.arm.base_rotation().T

    def link_regressor(self, link: int) -> np.ndarray:
        """The bodies' torque by the inertial parameters of a link, (N, n, 10)."""
        motion = self.motion
        return self._changed.link_regressor(link, self.q, motion.dq, motion.ddq)

    @cached_property
    def transmitted(self) -> np.ndarray:
        """Torque through the transmissions as recorded [N m], (N, n): what reached the motors less what they need."""
        recorded = self.bodies.segment.recorded_torque
        # friction and rotors take from the motor, springs and bodies from the link
        of_motors = [
            e for e in self.arm.effects if e.effect.family in ("friction", "rigid_body")
        ]
        bare = replace(self.arm, effects=tuple(of_motors))
        scale = 1.0 + self.arm.quantity("scale")
        needed = bare.needed_torque(np.zeros_like(recorded), self.motion)
        return np.asarray(scale * self.arm.delivered(recorded, self.motion) - needed)

    def value(self, effect: str, parameter: str) -> np.ndarray:
        """Values of an effect's parameter over all joints, (n,)."""
        return self.arm.value(effect, parameter)

    def nominal_play(self, width: float) -> np.ndarray:
        """Torque per radian from free play [rad] on each nominal joint, (N, n, n)."""
        return self.bodies.play(width)

    def rigid_with(self, effect: Effect, x: np.ndarray) -> np.ndarray:
        """Torque of the bodies with an effect at other linear coordinates, (linear, m) [N m], (N, n)."""
        theta, chosen = self.theta.copy(), self.terms.choosable(effect.name)
        for term, own in zip(chosen, x.T, strict=True):
            theta[list(term.columns)] = own
        # what is zero there is off
        mine = [t for t in chosen if theta[list(t.columns)].any()]
        arm = self.with_terms(effect.name, theta, mine)
        return arm.rigid_torque(self.bodies.body, self.motion)

    def with_terms(
        self, effect: str, theta: np.ndarray, mine: Sequence[Term]
    ) -> CorrectedArm:
        """The arm with some terms of an effect, and none else of it, at other coordinates, (P,)."""
        others = tuple(e for e in self.arm.effects if e.name != effect)
        return replace(self.arm, effects=(*others, *self.terms.effects(theta, mine)))

    def acts_on_bodies(self, effect: Effect) -> bool:
        """Whether an effect changes the torque of all joints by way of their bodies."""
        # behind encoders on the joints a transmission moves the motors, not the links
        behind = isinstance(effect, Transmission) and self.arm.arm.encoder == "joint"
        return effect.reach == "arm" and not behind

    @cached_property
    def torque_size(self) -> np.ndarray:
        """RMS of the torque of each joint [N m], (n,), not far below that of others; 1 of an arm without any."""
        size = np.sqrt((self.torque**2).mean(axis=0))
        largest = float(size.max())
        return np.maximum(size, MIN_TORQUE * largest) if largest else np.ones(len(size))

    def changes(self, arms: Sequence[CorrectedArm]) -> np.ndarray:
        """By how much K arms whose bodies move as this one's predict another torque [N m], (N, K, n)."""
        own, motion = _path(self.arm), self.motion
        out = np.empty((len(self.rigid), len(arms), self.rigid.shape[1]))
        # arms that differ on the way to the joint have each to be followed along it
        alike, needed = [], []
        for k, arm in enumerate(arms):
            torque = arm.needed_torque(self.rigid, motion)
            if _path(arm) == own:
                alike.append(k)
                needed.append(torque)
            else:
                out[:, k] = arm.recorded_torque(torque, motion)
        # the way from the recorded torque to the joint is undone for all at once
        if needed:
            stacked = np.stack(needed, axis=1)
            out[:, alike] = self.arm.recorded_torque(stacked, motion)
        return out - self.torque[:, None]

    def as_recorded(self, columns: np.ndarray) -> np.ndarray:
        """Columns of the bodies' torque, (N, n, K), as recorded: through friction, scale, delay and lag."""
        arm, motion, step = self.arm, self.motion, TORQUE_STEP * self.torque_size
        # per joint and sample: what is recorded for a little more on the bodies
        above, below = (
            arm.recorded_torque(arm.needed_torque(self.rigid + side, motion), motion)
            for side in (step, -step)
        )
        # where dry friction changes its sign the difference is no derivative
        gain = np.clip(
            (above - below) / (2 * step), 1 / MAX_TORQUE_GAIN, MAX_TORQUE_GAIN
        )
        # each joint's shifted by its delay and lag, to first order in time
        delays = (values[0] for effect, values in arm.of_kind(Path) if effect.delays)
        ahead: np.ndarray = sum(delays, np.zeros(len(step)))
        if ahead.any():
            # what arrives late is recorded early: x(t + T) = x + T dx/dt
            late = ahead[:, None] * np.gradient(columns, motion.t, axis=0)
            columns = columns + late
        return columns * gain[:, :, None]


def _path(arm: CorrectedArm) -> list[int]:
    """Which effects lie between the recorded torque and the joint."""
    # moved arms hold the same objects for all effects that were not moved
    return [id(e) for e in arm.effects if isinstance(e.effect, Path)]


def columns(
    at: LinearisationPoint,
    data: DecimatedSegments,
    only: Collection[str] | None = None,
) -> np.ndarray:
    """Rows of the derivatives of the predicted torque by theta, (M, n, P) [N m] per unit of theta.

    Those of changed links are left zero: they are combinations of the inertial regressor.

    Args:
        at: where they are taken.
        data: the data, of which it is a segment.
        only: effects whose columns are wanted; all if ``None``, the others' are zero.
    """
    segment, terms = at.bodies.segment, at.terms
    wanted = [e for e in terms.definitions if only is None or e.name in only]
    out = np.zeros((len(data.time(segment)), at.arm.arm.n_joints, terms.size))
    moves = [move for effect in wanted for move in _moves(at, effect)]
    # moved arms are predicted together, as many as memory allows
    at_once = max(1, MAX_NUMBERS // at.torque.size)
    for start in range(0, len(moves), at_once):
        some = moves[start : start + at_once]
        begun = [move.begun for move in some if move.begun is not None]
        arms = [*(move.arm for move in some), *begun]
        changes = np.moveaxis(data.thin(at.changes(arms), segment), 1, 0)
        before = iter(changes[len(some) :])
        for move, change in zip(some, changes, strict=False):
            own = change if move.begun is None else change - next(before)
            out[:, move.joints, move.places] = own / move.step
    for term in terms.all:
        effect, j = term.definition, term.joint - 1
        if isinstance(effect, Path) and effect.limits and term in terms.shapes:
            # what is not delivered of the recorded torque
            searched = np.array(terms.shapes[term])[:, None]
            values = effect.values_at(np.ones((len(term.columns), 1)), searched)
            torque = segment.recorded_torque[:, j]
            at_joint = Moment(segment.motion.q[:, j], segment.motion.dq[:, j])
            lost = torque - effect.applied(torque, at_joint, *values.values())
            out[:, j, term.columns[0]] = data.thin(lost, segment)
    bodily = [pair for effect in wanted for pair in _rigid_body_jacobian(at, effect)]
    if bodily:
        # all at once: the way to the recorded torque is followed but once
        places, torques = zip(*bodily, strict=True)
        recorded = at.as_recorded(np.stack(torques, axis=2))
        out[:, :, list(places)] = data.thin(recorded, segment)
    return out


class _Perturbation(NamedTuple):
    """The arm with some coordinates moved by a step, and the columns that the change of its torque gives.

    Attributes:
        arm: with the coordinates moved.
        begun: the arm from which they are moved; ``None`` for the arm itself.
        step: by which they are, of each of these joints or of all.
        joints, places: of the columns: whose torque they are of, and where they lie in theta.
    """

    arm: CorrectedArm
    begun: CorrectedArm | None
    step: np.ndarray | float
    joints: np.ndarray | slice
    places: np.ndarray | int


def _moves(at: LinearisationPoint, effect: Effect) -> Iterator[_Perturbation]:
    """The moves for an effect on a joint, by each coordinate on all joints at once, or for one on a motor.

    Coordinates beyond the first mean nothing of a torque law that is off, as the rest of a spring without stiffness:
    they are moved from an arm on which the first is larger than all of them, so that no bound is met. Their columns are
    the same there, as the law is linear.
    """
    chosen, theta = at.terms.choosable(effect.name), at.theta
    step, joints = effect.fitted.step, np.arange(at.arm.arm.n_joints)
    steps = TORQUE_STEP * at.torque_size if step is None else np.full(len(joints), step)

    def moved(theta: np.ndarray, places: list[int], step: np.ndarray) -> CorrectedArm:
        theta = theta.copy()
        theta[places] += step
        return at.with_terms(effect.name, theta, chosen)

    if effect.reach == "motor":
        # a motor moves several joints, so that each takes a move of its own
        largest = steps.max()
        for term in chosen:
            place = term.columns[0]
            arm = moved(theta, [place], largest)
            yield _Perturbation(arm, None, largest, slice(None), place)
    # what cuts the delivered torque changes none that is needed
    elif chosen and not (effect.limits or at.acts_on_bodies(effect)):
        own = steps[[t.joint - 1 for t in chosen]]
        on, begun, first = theta, None, [t.columns[0] for t in chosen]
        for coordinate, block in enumerate(at.terms.block(effect.name)):
            if coordinate == 1 and isinstance(effect, TorqueLaw):
                on = theta.copy()
                every = np.array([t.columns for t in chosen])
                on[first] = own + np.abs(theta[every]).sum(axis=1)
                begun = moved(on, [], own[:0])
            arm = moved(on, [t.columns[coordinate] for t in chosen], own)
            yield _Perturbation(arm, begun, steps, joints, block)


def _rigid_body_jacobian(
    at: LinearisationPoint, effect: Effect
) -> Iterator[tuple[int, np.ndarray]]:
    """Places in theta, and the derivatives of the bodies' torque by them, (N, n), of an effect on the bodies.

    Those of changed links are left out: they are combinations of the inertial regressor, which is kept.
    """
    of_links = isinstance(effect, LinkChange) and effect.scope == "link"
    chosen = at.terms.choosable(effect.name)
    if of_links or not chosen or not at.acts_on_bodies(effect):
        return
    # coordinate by coordinate, joint by joint
    places = np.array([t.columns for t in chosen]).T
    searched = np.array([at.terms.shapes.get(t, ()) for t in chosen]).T
    derivatives = effect.columns(at, at.theta[places], searched)
    for i, j in np.ndindex(*places.shape):
        yield int(places[i, j]), derivatives[:, :, i, j]
