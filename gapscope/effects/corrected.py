"""The corrected arm: the nominal arm plus the effects found; it predicts the torque that would be recorded.

From the motion that the encoders saw: sensing effects are undone; the links move as the encoders say, or behind the
transmission by its deflection; the bodies, rotors, friction and springs need a torque; the way from the recorded torque
to the joint is undone. What a series of t and q alone cannot give, the impact of backlash and the rounding of encoders,
is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.deflection import through_play, through_springs
from gapscope.effects.effect import (
    SHEET,
    Drift,
    Effect,
    External,
    LinkChange,
    Path,
    Sensing,
    Signals,
    TorqueLaw,
    Transmission,
    Turn,
)
from gapscope.effects.friction import friction_direction
from gapscope.effects.residual import ResidualNetwork
from gapscope.effects.signals import MotionSeries, slow_with_rates

K = TypeVar("K", bound=Effect)
"""A kind of effects."""


# An arm is passive if over any motion it gives back no more energy than it was given: friction power dq tau_f >= 0 and
# dq^T M(q) dq >= 0. Springs may be negative: their energy depends on the position alone.


ROUNDING = 1e-8
"""Values this far below zero are rounding, and count as zero [N m, N m s/rad, kg m^2]."""
NOT_NEGATIVE = {
    f"{of}{quantity}": unit
    for of in ("", "motor_")
    for quantity, unit in (
        ("friction", "N m"),
        ("damping", "N m s/rad"),
        ("rotor", "kg m^2"),
    )
}
"""Quantities of drives that feed energy in below zero, with their units."""


def total(values: np.ndarray, name: str, unit: str) -> np.ndarray:
    """Values per joint that may not be negative, since that would feed energy in, shape (n,); rounding is taken off.

    Raises:
        InputError: one is negative.
    """
    # an increment below zero is fine as long as the data sheet has as much
    if (values < -ROUNDING).any():
        joint = int(values.argmin())
        raise InputError(
            f"nominal value plus effect is {values[joint]:.4g} {unit} at joint {joint + 1}, which would feed energy in",
            "give an increment that leaves the total at zero or above",
            where=name,
        )
    return np.maximum(values, 0.0)


def _is_movable(body: RigidBody) -> bool:
    """Whether bodies have positive kinetic energy in every posture that is looked at, as real ones have."""
    try:
        check_inertia(body)
    except InputError:
        return False
    return True


@dataclass(frozen=True)
class CorrectedArm:
    """The nominal arm with effects.

    Attributes:
        arm: the nominal arm.
        effects: the effects, each once per joint or arm; those that add (payload, link errors, forces) at will. Of an
            arm with states those of the last one.
        residual: adds to the predicted torque what no effect explains, or ``None``.
        remainder: inertial parameters that the links lack to predict the torque best, (n, 10), in the order of
            ``INERTIAL_PARAMETERS``; or ``None``. Links with them need not be possible: no simulator has them.
        states: what it has in some recordings, or spans of them, in place of ``effects``.
    """

    arm: NominalArm
    effects: tuple[AppliedEffect, ...] = ()
    residual: ResidualNetwork | None = None
    remainder: np.ndarray | None = None
    states: tuple[State, ...] = ()

    @property
    def lasting(self) -> CorrectedArm:
        """The arm without forces from outside, which belong to the recording in which they acted."""
        own = tuple(e for e in self.effects if not isinstance(e.effect, External))
        return replace(self, effects=own)

    @property
    def known(self) -> tuple[str, ...]:
        """Recordings of which the state is known, if that differs; the last one last."""
        every = (name for state in self.states for name in state.place.recordings)
        return tuple(dict.fromkeys(every))

    def taken_as(self, recording: str) -> str | None:
        """What is said of a recording whose state is not known; ``None`` if it is, or there is one state only."""
        if not self.states or recording in self.known:
            return None
        return f"{recording}: its state is not known; taken as in {self.known[-1]}, the last one"

    def spans(
        self, recording: str, t: np.ndarray
    ) -> list[tuple[np.ndarray, CorrectedArm]]:
        """The samples of a recording at times t [s], (N,), that share a state, and the arm in that state.

        A recording whose state is not known has the last one.
        """
        everywhere = np.ones(len(t), dtype=bool)
        mine = [s for s in self.states if recording in s.place.recordings]
        # no recording is told apart, or this one is not known
        if not mine:
            return [(everywhere, replace(self, states=()))]
        return [
            (inside, replace(self, effects=state.effects, states=()))
            for state in mine
            # a part between two samples holds none
            if (inside := (t >= state.place.start) & (t < state.place.end)).any()
        ]

    def check(self) -> None:
        """Check that every joint, coupled motor and link named exists, and that no effect contradicts itself.

        Raises:
            InputError: a joint, motor or link does not exist, or an effect that cannot add occurs twice at one place;
                or friction or armature is negative in total, which would feed energy in.
        """
        if self.residual is not None:
            self.residual.check(self.arm.n_joints)
        expected = self.arm.n_joints, 10
        if self.remainder is not None and self.remainder.shape != expected:
            raise InputError(
                f"has shape {self.remainder.shape}, expected {expected}",
                "give ten inertial parameters for each link, or leave it out",
                where="remainder",
            )
        for state in self.states:
            replace(self, effects=state.effects, states=()).check()
        places: set[tuple[str, int]] = set()
        for applied in self.effects:
            applied.check(self.arm.n_joints)
            lone = set(applied.joints) - set(self.arm.coupled_motors)
            if applied.effect.reach == "motor" and lone:
                raise InputError(
                    f"motor {min(lone)} is not declared to turn several joints",
                    "say so in the case: nominal: {coupling: [{motor: 6, joint: 5, ratio: 1}]}",
                    where=applied.name,
                )
            # these add up at one place
            if isinstance(applied.effect, LinkChange | External):
                continue
            # an effect of the arm has no joints: its place is 0
            here = {(applied.name, joint) for joint in applied.joints or (0,)}
            twice = sorted(joint for _, joint in here & places)
            if twice:
                place = f"joint {twice[0]}" if twice[0] else "the arm"
                raise InputError(
                    f"occurs twice on {place}",
                    "give it once, with the value that counts",
                    where=applied.name,
                )
            places |= here
        # with the data sheet: what an effect takes away may not be more than there is
        for applied in self.effects:
            for quantity in applied.effect.quantities.values():
                if quantity in NOT_NEGATIVE:
                    self.passive(quantity, applied.name)

    def value(self, name: str, parameter: str) -> np.ndarray:
        """Values of a joint effect's parameter over all joints, zeros if it does not act; shape (n,)."""
        n = self.arm.n_joints
        # an effect may occur several times, on different joints
        named = (e.per_joint(parameter, n) for e in self.effects if e.name == name)
        return sum(named, np.zeros(n))

    def quantity(self, name: str) -> np.ndarray:
        """A quantity of the drives, a key of ``QUANTITIES``: the data sheet's and all that effects add, shape (n,)."""
        # the data sheet states some of them, all others begin at zero
        sheet = SHEET.get(name)
        nominal = (
            np.zeros(self.arm.n_joints) if sheet is None else getattr(self.arm, sheet)
        )
        added = [
            applied.per_joint(parameter, self.arm.n_joints)
            for applied in self.effects
            for parameter, quantity in applied.effect.quantities.items()
            # what acts on a link or the arm has no value per joint
            if quantity == name and applied.joints
        ]
        return sum(added, nominal)

    def passive(self, name: str, where: str = "") -> np.ndarray:
        """A quantity that may not be negative in total, a key of ``NOT_NEGATIVE``, of joints or coupled motors, (n,).

        Raises:
            InputError: it is negative; ``where`` names what is at fault, the quantity by default.
        """
        return total(self.quantity(name), where or name, NOT_NEGATIVE[name])

    def of_kind(self, kind: type[K]) -> list[tuple[K, list[np.ndarray]]]:
        """Effects of a kind on joints, each with its parameters over all joints, in their order, shape (n,)."""
        n = self.arm.n_joints
        found = []
        for applied in self.effects:
            effect = applied.effect
            if isinstance(effect, kind) and applied.joints:
                values = [applied.per_joint(name, n) for name in effect.names]
                found.append((effect, values))
        return found

    def inertial_increments(self, body: RigidBody) -> np.ndarray:
        """Inertial parameters that payload and link errors add to the nominal links, shape (n, 10), joint order.

        A link's errors are those of the link itself, without a known body that it carries.
        """
        n = self.arm.n_joints
        # of a link without the load that it is known to carry
        own = body.unladen.inertial_parameters().reshape(n, 10)
        out = np.zeros((n, 10))
        for applied in self.effects:
            if not isinstance(applied.effect, LinkChange):
                continue
            applied.check(n)
            values = applied.parameters
            # a payload has no link of its own: it is the last one's
            link = int(values["link"]) - 1 if "link" in values else body.last_link
            out[link] += applied.effect.change(own[link], *values.values())
        return out

    def base_rotation(self) -> np.ndarray:
        """R from the base to the world frame, shape (3, 3)."""
        for applied in self.effects:
            # ``check`` allows one turn
            if isinstance(applied.effect, Turn):
                return applied.effect.rotation(*applied.parameters.values())
        return np.eye(3)

    def body(self, nominal: RigidBody) -> RigidBody:
        """Rigid bodies with payload, link errors and tilt, for a simulator."""
        # R^T g: gravity in the base frame
        return nominal.changed(
            self.inertial_increments(nominal), self.base_rotation().T @ self.arm.gravity
        )

    def feeds_energy(self, nominal: RigidBody) -> bool:
        """Whether effects turn bodies of positive kinetic energy into bodies that have none, or a negative one.

        A payload below zero takes mass from the last link at a point; with it may go more inertia than the link has.
        """
        # a nominal arm that is at fault itself is not the effects'
        return not _is_movable(self.body(nominal)) and _is_movable(nominal)

    def true_position(self, q: np.ndarray) -> np.ndarray:
        """Position [rad] of what the encoders sit on from the recorded one, shape (N, n): sensing effects undone."""
        for effect, values in self.of_kind(Sensing):
            q = effect.true(q, *values)
        return q

    def rigid_torque(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque of the bodies, against an external force too [N m], (N, n), without rotors and friction."""
        motion = replace(motion, q=self.true_position(motion.q))
        if any(isinstance(e.effect, Turn) for e in self.effects):
            # gravity first, since what links gain or lack weighs in its direction
            unchanged = np.zeros((self.arm.n_joints, 10))
            gravity = self.base_rotation().T @ self.arm.gravity
            body = body.changed(unchanged, gravity)
        increments = self.inertial_increments(body)
        if self.remainder is not None:
            increments = increments + self.remainder
        state = motion.q, motion.dq, motion.ddq
        torque = body.inverse_dynamics(*state)
        # linear in what is added: no other body has to be made
        for link in np.flatnonzero(increments.any(axis=1)):
            torque = torque + body.link_regressor(link, *state) @ increments[link]
        for applied in self.effects:
            if isinstance(applied.effect, External):
                force, start, end = applied.parameters.values()
                active = applied.effect.active(motion.t, start, end) > 0
                in_base = self.base_rotation().T @ force
                # what the force does the motors need not
                torque[active] -= body.force_torque(motion.q[active], in_base)
        if self.arm.encoder == "joint":
            # the links move as the encoders say, whatever lies between them and the motors
            return torque
        gear = ("gear_stiffness", "gear_damping", "play")
        stiffness, damping, width = map(self.quantity, gear)
        # with free play its solver follows the spring too
        elastic = np.where(width > 0, 0.0, stiffness)
        if not (width.any() or elastic.any()):
            return torque
        # of the bodies with all that they gained: that bends as well
        matrices = body.changed(increments).sensitivities(*state)
        if width.any():
            torque = through_play(matrices, motion, torque, width, stiffness, damping)
        if elastic.any():
            torque = through_springs(matrices, motion, torque, elastic, damping)
        return torque

    def _motor_motion(self, rigid: np.ndarray, motion: Motion) -> Motion:
        """Motion of the motors, joint side, from the recorded one and the torque of the bodies [N m], (N, n)."""
        motor = replace(motion, q=self.true_position(motion.q))
        between = self.of_kind(Transmission)
        if self.arm.encoder == "motor" or not between:
            return motor
        # theta - q under the torque through the transmission
        series, deflection = MotionSeries(motion), np.zeros_like(rigid)
        for effect, values in between:
            # bent by the torque as if stiff, and late by the lag
            static = effect.deflection(rigid, *values)
            deflection += series.lagged(static, effect.lag(*values))
        ahead, ahead_rate, ahead_acceleration = slow_with_rates(deflection, motion)
        return Motion(
            motion.t,
            motor.q + ahead,
            motor.dq + ahead_rate,
            motor.ddq + ahead_acceleration,
        )

    def needed_torque(self, rigid: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that must reach the joints [N m], (N, n): rigid bodies, rotors, springs and friction.

        Rotors and friction turn with the motors, springs with the joints; nominal and found values add up.
        """
        arm = self.arm
        motor = self._motor_motion(rigid, motion)
        position, t = self.true_position(motion.q), motion.t[:, None]
        friction = []
        torque = rigid + self.quantity("rotor") * motor.ddq
        for law, values in self.of_kind(TorqueLaw):
            if law.reach == "motor":
                continue
            # friction comes last: it follows the direction, and drifts
            if law.family == "friction":
                friction.append((law, values))
                continue
            torque = torque + law.law(Signals(t, position, motor.dq, torque), *values)
        direction = _direction(motor.q, motor.dq, arm)
        # the data sheet's friction drifts like all other
        factor = self.drift(motion.t)
        plain = arm.coulomb * direction + arm.viscous * motor.dq
        torque = torque + factor * plain
        # load friction last: it acts on the whole motor torque
        friction.sort(key=lambda item: getattr(item[0], "varies_with", "") == "load")
        for law, values in friction:
            signals = Signals(t, position, motor.dq, torque, direction)
            torque = torque + factor * law.law(signals, *values)
        return torque + self._coupled_torque(motor)

    def _coupled_torque(self, motion: Motion) -> np.ndarray | float:
        """Torque that the rotors and the friction of coupled motors need on the joints [N m], (N, n); 0 without any.

        Their friction does not drift.
        """
        drives = self.arm.coupling
        laws = [item for item in self.of_kind(TorqueLaw) if item[0].reach == "motor"]
        inertia = self.quantity("motor_rotor")
        if drives is None or not (laws or inertia.any()):
            return 0.0
        # motor speeds are C dq, and by equal power torques are C^T of the motors'
        position, speed = motion.q @ drives.T, motion.dq @ drives.T
        torque = inertia * (motion.ddq @ drives.T)
        direction = _direction(position, speed, self.arm)
        for law, values in laws:
            signals = Signals(motion.t[:, None], position, speed, torque, direction)
            torque = torque + law.law(signals, *values)
        return torque @ drives

    def drift(self, t: np.ndarray) -> np.ndarray | float:
        """Factor of all friction at times t [s] of shape (N,); 1 or shape (N, n)."""
        factor: np.ndarray | float = 1.0
        for effect, values in self.of_kind(Drift):
            factor = factor * (1.0 + effect.change(t[:, None], *values))
        return factor

    def recorded_torque(self, needed: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that would be recorded [N m]: the way to the joint undone, nearest to the joint first.

        Args:
            needed: torque that must reach the joints [N m], (N, n), or K of them, (N, K, n).
            motion: the recorded motion.
        """
        path = self.of_kind(Path)
        if not path:
            return needed
        true = replace(motion, q=self.true_position(motion.q))
        series = MotionSeries(true, many=needed.ndim == 3)
        # the place nearest to the joint acts last on a torque, and is undone first
        for effect, values in sorted(path, key=lambda item: -item[0].place):
            needed = effect.inverse(needed, series, *values)
        return needed

    @property
    def unlimited(self) -> CorrectedArm:
        """The same arm without saturation."""
        return replace(
            self,
            effects=tuple(e for e in self.effects if not e.effect.limits),
        )

    def delivered(self, recorded: np.ndarray, motion: Motion) -> np.ndarray:
        """The part of a recorded torque that remains [N m], (N, n), after saturation, on its motion."""
        series = MotionSeries(motion)
        # saturation alone: what delays or scales is undone on the other side
        for effect, values in self.of_kind(Path):
            if effect.limits:
                recorded = effect.applied(recorded, series, *values)
        return recorded

    def predict(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque that would be recorded on this motion [N m], shape (N, n)."""
        rigid = self.rigid_torque(body, motion)
        needed = self.needed_torque(rigid, motion)
        torque = self.recorded_torque(needed, motion)
        if self.residual is None:
            return torque
        # what the arm predicts is also the load that the network sees
        return torque + self.residual.torque(motion, torque)


def _direction(
    position: np.ndarray, velocity: np.ndarray, arm: NominalArm
) -> np.ndarray:
    """Direction of dry friction of joints or motors [1], (N, n); what counts as a radian is one."""
    size = arm.per_radian
    return friction_direction(position / size, velocity / size, arm.presliding / size)
