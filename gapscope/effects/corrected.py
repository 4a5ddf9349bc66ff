"""The corrected arm: the nominal arm plus the effects found; it predicts the torque that would be recorded.

From the motion that the encoders saw: sensing effects are undone; the links move as the encoders say, or behind the
transmission by its deflection; the bodies, rotors, friction and springs need a torque; the way from the recorded torque
to the joint is undone. What a series of t and q alone cannot give, the impact of backlash and the rounding of encoders,
is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.deflection import behind_elasticity, behind_play
from gapscope.effects.effect import (
    Drift,
    Effect,
    External,
    LinkChange,
    Path,
    Sensing,
    Signals,
    TorqueLaw,
    Transmission,
)
from gapscope.effects.environment import tilt
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.series import MotionSeries

SLOW = 12.0
"""Deflections of a transmission are followed up to this frequency [Hz]; their acceleration has no meaning above it."""


@dataclass(frozen=True)
class CorrectedArm:
    """The nominal arm with effects.

    Attributes:
        arm: the nominal arm.
        effects: the effects, each once per joint or arm; those that add (payload, link errors, forces) at will.
        residual: adds to the predicted torque what no effect explains, or ``None``.
    """

    arm: NominalArm
    effects: tuple[AppliedEffect, ...] = ()
    residual: ResidualNetwork | None = None

    def check(self) -> None:
        """Check that every joint and link named exists, and that no effect contradicts itself.

        Raises:
            InputError: a joint or link does not exist, or an effect that cannot add occurs twice at one place.
        """
        if self.residual is not None:
            self.residual.check(self.arm.n_joints)
        places: set[tuple[str, int]] = set()
        for applied in self.effects:
            applied.check(self.arm.n_joints)
            if isinstance(applied.effect, LinkChange | External):
                continue
            here = {(applied.name, joint) for joint in applied.joints or (0,)}
            if twice := sorted(here & places):
                joint = twice[0][1]
                raise InputError(
                    f"occurs twice on {f'joint {joint}' if joint else 'the arm'}",
                    "give it once, with the value that counts",
                    where=applied.name,
                )
            places |= here

    def value(self, name: str, parameter: str) -> np.ndarray:
        """Values of a joint effect's parameter over all joints, zeros where it does not act; shape (n,)."""
        n = self.arm.n_joints
        return sum(
            (e.per_joint(parameter, n) for e in self.effects if e.name == name),
            np.zeros(n),
        )

    def of_kind(self, kind: type[Effect]) -> list[tuple[Effect, list[np.ndarray]]]:
        """Effects of a kind on joints, each with its parameters over all joints, in their order, shape (n,)."""
        n = self.arm.n_joints
        chosen = [e for e in self.effects if isinstance(e.effect, kind) and e.joints]
        return [
            (e.effect, [e.per_joint(name, n) for name in e.effect.names])
            for e in chosen
        ]

    def inertial_increments(self, body: RigidBody) -> np.ndarray:
        """Inertial parameters that payload and link errors add to the nominal links, shape (n, 10), joint order.

        A link's errors are those of the link itself, without a known body that it carries.
        """
        n = self.arm.n_joints
        own, out = body.unladen.inertial_parameters().reshape(n, 10), np.zeros((n, 10))
        for applied in self.effects:
            if isinstance(applied.effect, LinkChange):
                applied.check(n)
                link = (
                    int(applied.parameters["link"]) - 1
                    if "link" in applied.parameters
                    else body.last_link
                )
                out[link] += applied.effect.change(
                    own[link], *applied.parameters.values()
                )
        return out

    def base_rotation(self) -> np.ndarray:
        """R from the base to the world frame, shape (3, 3)."""
        found = [e for e in self.effects if e.name == "base_tilt"]
        return (
            tilt(*(float(found[0].parameters[name]) for name in ("roll", "pitch")))
            if found
            else np.eye(3)
        )

    def body(self, nominal: RigidBody) -> RigidBody:
        """Rigid bodies with payload, link errors and tilt, for a simulator."""
        return nominal.changed(
            self.inertial_increments(nominal), self.base_rotation().T @ self.arm.gravity
        )

    def true_position(self, q: np.ndarray) -> np.ndarray:
        """Position [rad] of what the encoders sit on from the recorded one, shape (N, n): sensing effects undone."""
        for effect, values in self.of_kind(Sensing):
            assert isinstance(effect, Sensing)
            q = effect.true(q, *values)
        return q

    def rigid_torque(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque of the bodies, against a force from outside too [N m], (N, n), without rotors and friction."""
        motion = replace(motion, q=self.true_position(motion.q))
        if any(e.name == "base_tilt" for e in self.effects):
            body = body.changed(
                np.zeros((self.arm.n_joints, 10)),
                self.base_rotation().T @ self.arm.gravity,
            )
        increments = self.inertial_increments(body)
        torque = self._body_torque(body, increments, motion)
        if self.arm.encoder == "joint":
            return torque
        stiffness, damping = (
            self.value("joint_elasticity", name) for name in ("stiffness", "damping")
        )
        width = self.value("backlash", "width")
        if width.any():
            torque = behind_play(
                body.changed(increments), motion, torque, width, stiffness, damping
            )
        elastic = np.where(width > 0, 0.0, stiffness)
        if elastic.any():
            torque = behind_elasticity(
                body.changed(increments), motion, torque, elastic, damping
            )
        return torque

    def _body_torque(
        self, body: RigidBody, increments: np.ndarray, motion: Motion
    ) -> np.ndarray:
        """Inverse dynamics of the links' motion [N m], (N, n), less what a force from outside does."""
        torque = body.inverse_dynamics(motion.q, motion.dq, motion.ddq)
        if (
            increments[body.last_link].any()
            and not np.delete(increments, body.last_link, axis=0).any()
        ):
            torque = (
                torque
                + body.last_link_regressor(motion.q, motion.dq, motion.ddq)
                @ increments[body.last_link]
            )
        elif increments.any():
            torque = (
                torque
                + body.regressor(motion.q, motion.dq, motion.ddq) @ increments.ravel()
            )
        for applied in self.effects:
            if isinstance(applied.effect, External):
                force, start, end = applied.parameters.values()
                active = applied.effect.active(motion.t, start, end) > 0
                torque[active] -= body.force_torque(
                    motion.q[active], self.base_rotation().T @ force
                )
        return torque

    def _deflection(self, torque: np.ndarray, motion: Motion) -> np.ndarray:
        """Theta - q [rad], (N, n), under the torque through the transmission [N m]."""
        out = np.zeros_like(torque)
        for effect, values in self.of_kind(Transmission):
            assert isinstance(effect, Transmission)
            out += MotionSeries(motion).lagged(
                effect.deflection(torque, *values), effect.lag(*values)
            )
        return out

    @staticmethod
    def _moved(motion: Motion, deflection: np.ndarray, sign: float) -> Motion:
        """The motion plus ``sign`` times the slow part of a deflection [rad], (N, n), with its derivatives."""
        rates = slow_with_rates(deflection, motion)
        q, dq, ddq = (
            x + sign * rate
            for x, rate in zip((motion.q, motion.dq, motion.ddq), rates, strict=True)
        )
        return Motion(motion.t, q, dq, ddq)

    def needed_torque(self, rigid: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that must reach the joints [N m], (N, n): rigid bodies, rotors, springs and friction.

        Rotors and friction turn with the motors, springs with the joints; nominal and found values add up.
        """
        arm = self.arm
        true = (
            self.true_position(motion.q)
            if self.of_kind(TorqueLaw) or self.of_kind(Transmission)
            else motion.q
        )
        motor = replace(motion, q=true)
        if arm.encoder == "joint" and self.of_kind(Transmission):
            motor = self._moved(motor, self._deflection(rigid, motion), 1.0)
        laws = [
            (law, values)
            for law, values in self.of_kind(TorqueLaw)
            if isinstance(law, TorqueLaw)
        ]
        torque = rigid + (arm.armature + self.value("armature", "inertia")) * motor.ddq
        for law, values in laws:
            if law.family != "friction":
                torque = torque + law.law(
                    Signals(motion.t[:, None], true, motor.dq, torque), *values
                )
        factor = self.drift(motion.t)
        torque = torque + factor * (
            arm.coulomb * smooth_sign(motor.dq) + arm.viscous * motor.dq
        )
        friction = [(law, values) for law, values in laws if law.family == "friction"]
        for law, values in sorted(
            friction, key=lambda item: item[0].name == "load_friction"
        ):
            # load friction last: it acts on the whole motor torque
            torque = torque + factor * law.law(
                Signals(motion.t[:, None], true, motor.dq, torque), *values
            )
        return torque

    def drift(self, t: np.ndarray) -> np.ndarray | float:
        """Factor of all friction at times t [s] of shape (N,); 1 or shape (N, n)."""
        factor: np.ndarray | float = 1.0
        for effect, values in self.of_kind(Drift):
            assert isinstance(effect, Drift)
            factor = factor * effect.factor(t[:, None], *values)
        return factor

    def recorded_torque(self, needed: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that would be recorded [N m], (N, n): the way to the joint undone, nearest to the joint first."""
        path = [
            (effect, values)
            for effect, values in self.of_kind(Path)
            if isinstance(effect, Path)
        ]
        series = MotionSeries(
            replace(motion, q=self.true_position(motion.q)) if path else motion
        )
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

    def delivered(self, recorded: np.ndarray) -> np.ndarray:
        """What is left of a recorded torque [N m], (N, n), after saturation."""
        for effect, values in self.of_kind(Path):
            if effect.limits:
                assert isinstance(effect, Path)
                recorded = effect.applied(recorded, None, *values)
        return recorded

    def predict(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque that would be recorded on this motion [N m], shape (N, n)."""
        torque = self.recorded_torque(
            self.needed_torque(self.rigid_torque(body, motion), motion), motion
        )
        return (
            torque
            if self.residual is None
            else torque + self.residual.torque(motion, torque)
        )


def slow_with_rates(
    deflection: np.ndarray, motion: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of a deflection [rad], (N, n), below ``SLOW``, with its first and second derivative by time."""
    sos = butter(4, min(SLOW, 0.4 * motion.rate), output="sos", fs=motion.rate)
    slow = sosfiltfilt(
        sos,
        deflection,
        axis=0,
        padlen=min(len(motion.t) - 1, int(3 * motion.rate / SLOW)),
    )
    rate = np.gradient(slow, motion.t, axis=0)
    return slow, rate, np.gradient(rate, motion.t, axis=0)
