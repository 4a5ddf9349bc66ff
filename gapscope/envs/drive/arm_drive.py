"""An arm with effects as a simulator needs it: its bodies, and all that acts between a command and them."""

from __future__ import annotations

import warnings

import numpy as np

from gapscope.arm.dynamics.odd_inertials import odd_inertials
from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import ModelWarning
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Inertial, LinkChange, Transmission
from gapscope.effects.passivity import total
from gapscope.envs.drive.coupled_motors import CoupledMotors
from gapscope.envs.drive.friction import Friction
from gapscope.envs.drive.loads import Loads, check_simulated
from gapscope.envs.drive.path import TorquePath
from gapscope.envs.drive.substeps import least_inertia, mass_matrices, substeps
from gapscope.envs.drive.two_mass import TwoMass


def nominal_body(arm: NominalArm, load: KnownLoad | None = None) -> RigidBody:
    """The nominal rigid bodies of an arm that can be simulated, with its known load.

    Raises:
        InputError: its inertia is not physical.
    """
    body = RigidBody(arm)
    check_inertia(body)
    for note in odd_inertials(body):
        warnings.warn(note, ModelWarning, stacklevel=3)
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
