"""An arm with effects as a simulator needs it: its bodies, its encoders, and what acts between a command and them."""

from __future__ import annotations

import warnings

import numpy as np

from gapscope.arm.dynamics.inertials import odd_inertials
from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import (
    Drift,
    DryLaw,
    External,
    Inertial,
    LinkChange,
    Path,
    Sensing,
    Signals,
    TorqueLaw,
    Transmission,
)
from gapscope.effects.passivity import total
from gapscope.effects.sensing import quantize
from gapscope.envs.drive.friction import CoupledMotors, Friction
from gapscope.envs.drive.path import TorquePath
from gapscope.envs.drive.rows import Laws, Rows, repeated
from gapscope.envs.drive.two_mass import TwoMass, least_inertia, mass_matrices, substeps

OF_ONE_MOMENT = (TorqueLaw, Drift, LinkChange, Path, Sensing, External)
"""Kinds of effects whose laws the simulator calls, knowing the present state alone."""


def check_simulated(effects: tuple[AppliedEffect, ...]) -> None:
    """Check that the simulator has a step for every effect.

    Raises:
        InputError: an effect whose parameters are not quantities of the drives, and that has no law of one moment.
    """
    for applied in effects:
        effect = applied.effect
        known = effect.quantities.keys() >= set(effect.names)
        in_time = isinstance(effect, Path) and effect.varies_with == "time"
        of_motor = effect.reach == "motor" and not isinstance(effect, DryLaw)
        called = isinstance(effect, OF_ONE_MOMENT) and not (in_time or of_motor)
        if not (known or called):
            raise InputError(
                "the simulator has no step for this effect",
                "leave it out, or add its step to gapscope/envs/drive",
                where=applied.name,
            )


class Loads:
    """Torque on the links [N m], J^T f less what the smooth laws of torque take, joints in kinematic order.

    Dry and viscous friction and coupled motors are solved with the step instead.

    Args:
        arm: an arm with effects.
        body: its nominal rigid bodies, at whose last link's centre of mass a force acts.

    Attributes:
        present: whether there are any.
        stiffness: of the springs [N m/rad], shape (n,).
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody) -> None:
        order = body.order
        self._body, self._arm = body, arm
        self.stiffness = arm.quantity("stiffness")[order]
        down = arm.base_rotation().T
        self._forces = []
        for applied in arm.effects:
            if isinstance(applied.effect, External):
                force, start, end = applied.parameters.values()
                self._forces.append((applied.effect, down @ force, start, end))
        self._laws = Laws(
            [item for item in arm.of_kind(TorqueLaw) if not _solved(item[0])], order
        )
        # what is friction drifts with it
        self._drifting = bool(arm.of_kind(Drift)) and any(
            law.family == "friction" for law, _ in self._laws.acting
        )
        self.present = bool(self._forces or self._laws.acting)

    def __call__(
        self, t: float, q: np.ndarray, dq: np.ndarray, load: np.ndarray
    ) -> np.ndarray:
        """Torque [N m], shape (n,).

        Args:
            t: time [s].
            q, dq: positions [rad] and velocities [rad/s], shape (n,).
            load: torque through the transmission [N m], shape (n,).
        """
        out = np.zeros_like(q)
        signals = Signals(t, q, dq, load)
        for law, values in self._laws.acting:
            torque = law.law(signals, *values)
            if self._drifting and law.family == "friction":
                factor = np.asarray(self._arm.drift(np.array([t])))
                torque = torque * factor[0, self._body.order]
            out -= torque
        for effect, force, start, end in self._forces:
            if effect.active(t, start, end):
                out += self._body.force_torque(q[self._body.places], force)[0][
                    self._body.order
                ]
        return out


def _solved(law: TorqueLaw) -> bool:
    """Whether a law of torque is solved with the step, since it is stiff at rest or acts on several joints."""
    viscous = "damping" in law.quantities.values()
    return isinstance(law, DryLaw) or viscous or law.reach == "motor"


class Encoders(Rows):
    """Reading = round((p' + noise) / step) step, p' what effects make of the position p of motor or joint; (n,).

    Args:
        arm: an arm with effects, in whose order the joints are; an effect with a resolution takes the place of
            ``step``, all others act on the position.
        step: quantisation of the data sheet [rad], 0 for none.

    Attributes:
        on_motor: whether they sit on the motors.
    """

    ROWS = ("_laws", "_step")

    def __init__(self, arm: CorrectedArm, step: float) -> None:
        self.on_motor = arm.arm.encoder == "motor"
        laws = [
            (law, values)
            for law, values in arm.of_kind(Sensing)
            if "resolution" not in law.quantities.values()
        ]
        self._laws = Laws(laws, np.arange(arm.arm.n_joints))
        coarse = arm.quantity("resolution")
        self._step = np.where(coarse > 0, coarse, step)
        self.note()

    def note(self) -> None:
        """Note what makes a reading."""
        self._plain = not (self._laws.acting or self._step.any())
        self._quiet = np.zeros(len(self._step))
        self._seen = repeated(self._read, 2, len(self._step))

    def undone(self, reading: np.ndarray) -> np.ndarray:
        """Position [rad] at which they, but for rounding and noise, read ``reading`` [rad]."""
        for law, values in reversed(self._laws.acting):
            reading = law.true(reading, *values)
        return reading

    def __call__(
        self, position: np.ndarray, noise: np.ndarray | None = None
    ) -> np.ndarray:
        """Reading [rad] for true positions [rad] and what is added before rounding [rad]."""
        if self._plain:
            return position.copy() if noise is None else position + noise
        return self._seen(position, self._quiet if noise is None else noise)

    def _read(self, position: np.ndarray, noise: np.ndarray) -> np.ndarray:
        seen = position
        for law, values in self._laws.acting:
            seen = law.recorded(seen, *values)
        seen = seen + noise
        return quantize(seen, self._step) if self._step.any() else seen


def nominal_body(arm: NominalArm, load: KnownLoad | None = None) -> RigidBody:
    """The nominal rigid bodies of an arm that can be simulated, with its known load.

    Raises:
        InputError: its inertia is not physical.
    """
    body = RigidBody(arm)
    check_inertia(body)
    for note in odd_inertials(body):
        warnings.warn(note, ModelWarning, stacklevel=4)
    return body.carrying(load)


class ArmDrive:
    """Bodies and drives of an arm with effects; arrays of n joints, in kinematic order.

    Args:
        arm: the nominal arm.
        effects: what the arm has beyond it.
        dt: time step [s] in which torque is held.
        nominal: its rigid bodies, as ``nominal_body`` gives them.

    Attributes:
        corrected: the arm with its effects.
        body: rigid bodies with load, payload, link errors and tilt.
        altered: whether these differ from the nominal ones.
        rotors: [kg m^2], shape (n,).
        loads, motors, friction, path, coupled: what acts on the joints.
        parts, h: into how many parts a step is divided, and their length [s].
        rigid: mask of the joints without a motor of their own, shape (n,).
        direct: whether nothing acts between torque and bodies.

    Raises:
        InputError: an effect on a joint that does not exist, or that has no step; armature or friction that is negative
            in total; a stiffness that the step cannot hold.
    """

    def __init__(
        self,
        arm: NominalArm,
        effects: tuple[AppliedEffect, ...],
        dt: float,
        nominal: RigidBody,
    ) -> None:
        self.corrected = CorrectedArm(arm, effects)
        self.corrected.check()
        check_simulated(effects)
        changes = [e.name for e in effects if isinstance(e.effect, LinkChange)]
        # what is inertial on a joint is its rotor
        self.altered = any(
            isinstance(e.effect, Inertial) and not e.joints for e in effects
        )
        self.body = self.corrected.body(nominal)
        if changes:
            check_inertia(self.body, ", ".join(changes))
        order = nominal.order
        rotors = self.corrected.quantity("rotor")
        self.rotors = total(rotors, "nominal.armature", "kg m^2")[order]
        self.loads = Loads(self.corrected, nominal)
        self._set_motors(effects, order, dt)
        self.friction = Friction(self.corrected, order, self.h)
        self.path = TorquePath(self.corrected, order, self.h)
        self.coupled = CoupledMotors(self.corrected, self.body, self.h)
        # with nothing between torque and bodies the engine steps on its own
        between = self.friction.present or self.rotors.any() or self.loads.present
        own_motors = bool(self.motors.joints.any())
        self.direct = not (between or own_motors or self.coupled.present)

    def _set_motors(
        self, effects: tuple[AppliedEffect, ...], order: np.ndarray, dt: float
    ) -> None:
        """Set the motors of compliant joints, and the parts of a step that follow their springs."""
        compliant = self.loads.stiffness.any() or any(
            isinstance(applied.effect, Transmission) for applied in effects
        )
        # of a rigid arm no inertia is asked for
        masses = mass_matrices(self.body) if compliant else np.eye(len(order))[None]
        self.motors = TwoMass(self.corrected, order, self.rotors, least_inertia(masses))
        self.rigid = ~self.motors.joints
        self.parts = substeps(
            masses,
            self.rotors,
            self.motors.joints,
            self.motors.stiffness,
            self.motors.damping,
            self.loads.stiffness,
            dt,
        )
        self.h = dt / self.parts
