"""The corrected arm: the nominal arm plus the effects found; it predicts the torque that would be recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from arm.dynamics import RigidBody
from arm.motion import Motion
from arm.nominal import NominalArm, smooth_sign
from effects.applied import AppliedEffect
from effects.effect import Path, Sensing, TorqueLaw
from effects.rigid_body import point_mass_parameters


@dataclass(frozen=True)
class CorrectedArm:
    """The nominal arm with effects.

    Attributes:
        arm: the nominal arm.
        effects: the effects, each of the catalogue at most once.
    """

    arm: NominalArm
    effects: tuple[AppliedEffect, ...] = ()

    def value(self, name: str, parameter: str) -> np.ndarray:
        """Values of a joint effect's parameter over all joints, zeros where it does not act; shape (n,)."""
        n = self.arm.n_joints
        return sum((e.per_joint(parameter, n) for e in self.effects if e.name == name), np.zeros(n))

    def payload(self) -> np.ndarray:
        """Ten inertial parameters that the payload adds to the last link, shape (10,)."""
        found = [e for e in self.effects if e.name == "payload"]
        return sum(
            (point_mass_parameters(float(e.parameters["mass"]), e.parameters["com"]) for e in found), np.zeros(10)
        )

    def true_position(self, q: np.ndarray) -> np.ndarray:
        """Position of the joints [rad] from the recorded one, shape (N, n): sensing effects undone."""
        for applied in self.effects:
            if isinstance(applied.effect, Sensing):
                q = applied.effect.true(q, *_values(applied, self.arm.n_joints))
        return q

    def rigid_torque(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque of the bodies and the payload [N m], shape (N, n), without rotor inertia and friction."""
        q = self.true_position(motion.q)
        torque = body.inverse_dynamics(q, motion.dq, motion.ddq)
        payload = self.payload()
        if payload.any():
            torque = torque + body.last_link_regressor(q, motion.dq, motion.ddq) @ payload
        return torque

    def needed_torque(self, rigid: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that must reach the joints [N m], (N, n): rigid bodies, rotors, and friction, nominal and found."""
        arm = self.arm
        inertia = arm.armature + self.value("armature", "inertia")
        torque = rigid + inertia * motion.ddq + arm.coulomb * smooth_sign(motion.dq) + arm.viscous * motion.dq
        laws = [(e.effect, _values(e, arm.n_joints)) for e in self.effects if isinstance(e.effect, TorqueLaw)]
        for law, values in sorted(laws, key=lambda item: item[0].name == "load_friction"):
            torque = torque + law.law(
                motion.dq, torque, *values
            )  # load friction last: it acts on the whole motor torque
        return torque

    def recorded_torque(self, needed: np.ndarray, motion: Motion) -> np.ndarray:
        """Torque that would be recorded [N m], (N, n): the way to the joint undone, nearest to the joint first."""
        shift = _Shift(motion.t)
        order = ("torque_offset", "torque_scale", "actuator_delay")
        path = [(e.effect, _values(e, self.arm.n_joints)) for e in self.effects if isinstance(e.effect, Path)]
        for effect, values in sorted(path, key=lambda item: order.index(item[0].name)):
            needed = effect.inverse(needed, *values, shift)
        return needed

    def predict(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque that would be recorded on this motion [N m], shape (N, n)."""
        return self.recorded_torque(self.needed_torque(self.rigid_torque(body, motion), motion), motion)


def _values(applied: AppliedEffect, n_joints: int) -> list[np.ndarray]:
    return [applied.per_joint(name, n_joints) for name in applied.effect.names]


class _Shift:
    """Evaluates series on the grid t at t + T, T per joint; constant beyond the ends."""

    def __init__(self, t: np.ndarray) -> None:
        self.t = t

    def __call__(self, series: np.ndarray, delay: np.ndarray) -> np.ndarray:
        out = np.array(series)
        for joint in np.flatnonzero(delay):
            spline = make_interp_spline(self.t, series[:, joint], k=3)
            out[:, joint] = spline(np.clip(self.t + delay[joint], self.t[0], self.t[-1]))
        return out
