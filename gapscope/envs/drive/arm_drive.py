"""An arm with effects as a simulator needs it: its bodies, its encoders, and what acts between a command and them.

A joint with elasticity or free play has two masses: motor and link, between them a spring, a damper and the play. A
time step is divided into as many parts as it takes to follow springs in and beside the joints.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.linalg import block_diag

from gapscope.arm.dynamics.inertials import odd_inertials
from gapscope.arm.dynamics.plain_urdf import POSTURES, check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import of_quantity
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
from gapscope.effects.sensing import quantize
from gapscope.effects.transmission import (
    backlash_deflection,
    elastic_deflection,
    elastic_torque,
    through_backlash,
)
from gapscope.envs.drive.laws import (
    CoupledMotors,
    Friction,
    Laws,
    Rows,
    TorquePath,
    repeated,
)

RESOLUTION = 0.1
"""Phase of the fastest resonance that a step may cover, w dt [rad]: its frequency is then right to 0.1 %."""
MAX_SUBSTEPS = 64
"""Parts into which a step may be divided."""
TOOTH_FREQUENCY = 150.0
"""Resonance of motor and link in the closed gear of a joint with backlash and without elasticity [Hz]."""
TOOTH_DAMPING = 0.2
"""Damping ratio of that resonance [1]."""


def teeth(
    inertia: np.ndarray, link_inertia: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness [N m/rad] and damping [N m s/rad] of teeth in contact, a stiff spring since a step knows no impacts.

    Args:
        inertia: of the rotors [kg m^2], shape (n,).
        link_inertia: of each joint's link side [kg m^2], shape (n,).
    """
    w = 2 * np.pi * TOOTH_FREQUENCY
    total = np.maximum(inertia + link_inertia, 1e-300)
    # motor and link swing against each other with this inertia
    reduced = inertia * link_inertia / total
    return w**2 * reduced, 2 * TOOTH_DAMPING * w * reduced


class TwoMass:
    """The motors of the joints with elasticity or backlash; each motor has its own position and velocity.

        I ddtheta = u - friction - tau,   tau = k z + d dz,   z = theta - q beyond free play,

    all on the joint side of the gear. Motor and link take their semi-implicit step with the same tau, so that momentum
    is kept. The damper acts if the gear is closed and never pulls its teeth apart.

    Args:
        arm: an arm with effects.
        order: the arm's joints in kinematic order.
        inertia: of the rotors [kg m^2], shape (n,), kinematic order.
        link_inertia: smallest inertia of each joint's link side [kg m^2], shape (n,).

    Attributes:
        joints: mask of the joints with two masses, shape (n,), kinematic order.
        position, velocity: of all motors, those of rigid joints being the joints' [rad, rad/s], shape (n,).
        stiffness, damping: k [N m/rad] and d [N m s/rad] of all joints, 0 on rigid ones, shape (n,).

    Raises:
        InputError: a joint with two masses has no rotor.
    """

    def __init__(
        self,
        arm: CorrectedArm,
        order: np.ndarray,
        inertia: np.ndarray,
        link_inertia: np.ndarray,
    ) -> None:
        k, d, self._width = (
            arm.quantity(name)[order]
            for name in ("gear_stiffness", "gear_damping", "play")
        )
        self.joints = (k > 0) | (self._width > 0)
        without_rotor = self.joints & (inertia <= 0)
        if without_rotor.any():
            joint = int(order[without_rotor][0]) + 1
            what = "gear_stiffness" if k[without_rotor][0] > 0 else "play"
            raise InputError(
                f"joint {joint} has a motor of its own but no rotor inertia",
                f"give nominal.armature in the data sheet, or add the effect {of_quantity('rotor')[0].name}",
                where=of_quantity(what)[0].name,
            )
        rigid_gear = self.joints & (k == 0)
        # of a gear with play alone the closed teeth are the spring
        if rigid_gear.any():
            tooth_stiffness, tooth_damping = teeth(inertia, link_inertia)
            k = np.where(rigid_gear, tooth_stiffness, k)
            d = np.where(rigid_gear, tooth_damping, d)
        self.stiffness, self.damping = k, d
        self._rigid = ~self.joints
        # 1 on rigid joints, whose motors follow anyway: nothing is divided by zero
        self._inertia = np.where(self.joints, inertia, 1.0)
        self._plays = bool(self._width.any())
        self._tight = self._width == 0
        self.position, self.velocity = np.zeros((2, len(k)))

    def reset(self, q: np.ndarray, dq: np.ndarray, load: np.ndarray) -> None:
        """Motors carry the load [N m] of their links at rest against them, each of shape (n,)."""
        self.position[:] = q + self.deflection(load)
        self.velocity[:] = dq

    def deflection(self, load: np.ndarray) -> np.ndarray:
        """Theta - q [rad] under a load [N m], shape (n,)."""
        bent = elastic_deflection(load, self.stiffness, self.damping)
        return bent + backlash_deflection(load, self._width)

    def torque(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Tau [N m] from motors to links at positions q and velocities dq, 0 on rigid joints, shape (n,)."""
        twist, rate = self.position - q, self.velocity - dq
        if not self._plays:
            return elastic_torque(twist, rate, self.stiffness, self.damping)
        wound = through_backlash(twist, self._width)
        # within the play nothing touches, and nothing damps
        closed = (wound != 0) | self._tight
        torque = elastic_torque(wound, rate * closed, self.stiffness, self.damping)
        # the damper may not pull teeth apart
        pushes = (torque * wound >= 0) | self._tight
        return torque * pushes

    def step(
        self,
        applied: np.ndarray,
        through: np.ndarray,
        limit: np.ndarray,
        viscous: np.ndarray,
        dt: float,
    ) -> None:
        """Move the motors on by one step; those of rigid joints have to ``follow`` then.

        Args:
            applied: motor torque u [N m], shape (n,).
            through: tau [N m].
            limit: of dry friction [N m].
            viscous: b [N m s/rad].
            dt: time step [s].
        """
        momentum = applied - through
        momentum *= dt
        momentum += self._inertia * self.velocity
        # dry friction takes momentum up to its limit, and at most stops the motor
        moving = np.abs(momentum)
        moving -= dt * limit
        np.copysign(np.maximum(moving, 0.0, out=moving), momentum, self.velocity)
        # viscous friction at the velocity after the step, which no step makes unstable
        self.velocity /= self._inertia + dt * viscous
        self.position += dt * self.velocity

    def follow(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Motors of rigid joints are where the joints are."""
        np.copyto(self.position, q, where=self._rigid)
        np.copyto(self.velocity, dq, where=self._rigid)


def mass_matrices(body: RigidBody) -> np.ndarray:
    """Mass matrices over postures within the limits [kg m^2], shape (POSTURES, n, n), joints in kinematic order."""
    masses = np.array([body.mass_matrix(q) for q in body.postures(POSTURES)])
    return masses[:, body.order][:, :, body.order]


def least_inertia(masses: np.ndarray) -> np.ndarray:
    """Smallest inertia that each joint feels while the others are free, 1 / (M^-1)_jj [kg m^2], shape (n,)."""
    return (1.0 / np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2)).min(axis=0)


def substeps(
    masses: np.ndarray,
    rotors: np.ndarray,
    elastic: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    spring: np.ndarray,
    dt: float,
) -> int:
    """Parts of a step of dt [s] of which the fastest resonance sees w h below ``RESOLUTION``.

    Args:
        masses: mass matrices of the bodies [kg m^2], shape (K, n, n).
        rotors: [kg m^2], shape (n,).
        elastic: mask of the joints with two masses, shape (n,).
        stiffness, damping: of their transmission [N m/rad], [N m s/rad], shape (n,).
        spring: stiffness of parallel springs [N m/rad], shape (n,).
        dt: time step [s].

    Raises:
        InputError: more than ``MAX_SUBSTEPS`` are needed; names the joint and the step that would do.
    """
    n, worst, joint, where = len(rotors), 0.0, 0, ""
    if not (elastic.any() or spring.any()):
        return 1
    # name inside a gear, its values, those beside the joint, and the power of an eigenvalue that is a rate
    kinds = (
        ("gear_stiffness", stiffness, np.abs(spring), 0.5),
        ("gear_damping", damping, 0.0 * spring, 1.0),
    )
    # without a motor 1 kg m^2 stands in, on which no spring acts
    on_motors = np.diag(np.where(elastic, rotors, 1.0))
    for mass in masses:
        # an elastic joint has its rotor on the motor's side
        on_links = mass + np.diag(np.where(elastic, 0.0, rotors))
        # L^-1 K L^-T is symmetric and has the eigenvalues of M^-1 K, with M = L L^T
        root = np.linalg.inv(np.linalg.cholesky(block_diag(on_links, on_motors)))
        for inside, values, beside, power in kinds:
            k = np.diag(np.where(elastic, values, 0.0))
            whole = np.block([[k + np.diag(beside), -k], [-k, k]])
            rates, modes = np.linalg.eigh(root @ whole @ root.T)
            if rates[-1] ** power > worst:
                worst = float(rates[-1] ** power)
                shape = np.abs(root.T @ modes[:, -1])
                # the joint that most takes part in the fastest mode
                joint = int((shape[:n] + shape[n:] * elastic).argmax())
                effect, name = of_quantity(inside if elastic[joint] else "stiffness")
                where = f"{effect.name}.{name}"
    parts = max(1, int(np.ceil(worst * dt / RESOLUTION - 1e-9)))
    if parts > MAX_SUBSTEPS:
        raise InputError(
            f"the stiffness or damping about joint {joint + 1} moves at {worst:.3g} rad/s, which steps of {dt:.3g} s "
            f"cannot hold, even in {MAX_SUBSTEPS} parts",
            f"use steps of at most {MAX_SUBSTEPS * RESOLUTION / worst:.2g} s, a lower stiffness or damping, or more "
            "rotor inertia",
            where=where,
        )
    return parts


OF_ONE_MOMENT = (TorqueLaw, Drift, LinkChange, Path, Sensing, External)
"""Kinds of effects whose laws the simulator calls, knowing the present state alone."""


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
        arm: an arm with effects; one with a resolution takes the place of ``step``, all others act on the position.
        order: the arm's joints in the order of the rows.
        step: quantisation of the data sheet [rad], 0 for none.

    Attributes:
        on_motor: whether they sit on the motors.
    """

    ROWS = ("_laws", "_step")

    def __init__(self, arm: CorrectedArm, order: np.ndarray, step: float) -> None:
        self.on_motor = arm.arm.encoder == "motor"
        # rounding comes last, behind the noise, and is no law of the position
        laws = [
            (law, values)
            for law, values in arm.of_kind(Sensing)
            if "resolution" not in law.quantities.values()
        ]
        self._laws = Laws(laws, order)
        coarse = arm.quantity("resolution")[order]
        self._step = np.where(coarse > 0, coarse, step)
        self.note()

    def note(self) -> None:
        """Note what makes a reading."""
        self._plain = not (self._laws.acting or self._step.any())
        self._quiet = np.zeros(len(self._step))
        self._seen = repeated(self._read, 2, len(self._step))

    def undone(self, reading: np.ndarray) -> np.ndarray:
        """Position [rad] at which they, but for rounding and noise, read ``reading`` [rad]."""
        # the last law first: what was done to the position last is undone first
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
        for applied in effects:
            effect = applied.effect
            # either all of its parameters are quantities that are solved with the step
            known = effect.quantities.keys() >= set(effect.names)
            in_time = isinstance(effect, Path) and effect.varies_with == "time"
            of_motor = effect.reach == "motor" and not isinstance(effect, DryLaw)
            # or its law can be asked at a moment, knowing the present state alone
            called = isinstance(effect, OF_ONE_MOMENT) and not (in_time or of_motor)
            if not (known or called):
                raise InputError(
                    "the simulator has no step for this effect",
                    "leave it out, or add its step to gapscope/envs/drive",
                    where=applied.name,
                )
        changes = [e.name for e in effects if isinstance(e.effect, LinkChange)]
        # what is inertial on a joint is its rotor
        self.altered = any(
            isinstance(e.effect, Inertial) and not e.joints for e in effects
        )
        self.body = self.corrected.body(nominal)
        # errors of links can make bodies that no torque moves: they are named
        if changes:
            check_inertia(self.body, ", ".join(changes))
        order = nominal.order
        self.rotors = self.corrected.passive("rotor", "nominal.armature")[order]
        self.loads = Loads(self.corrected, nominal)
        springs = self.loads.stiffness
        # of a rigid arm no inertia is asked for
        compliant = springs.any() or bool(self.corrected.of_kind(Transmission))
        masses = mass_matrices(self.body) if compliant else np.eye(len(order))[None]
        self.motors = TwoMass(self.corrected, order, self.rotors, least_inertia(masses))
        self.rigid = ~self.motors.joints
        between = self.motors.joints, self.motors.stiffness, self.motors.damping
        # a step is divided into parts that follow the springs
        self.parts = substeps(masses, self.rotors, *between, springs, dt)
        self.h = dt / self.parts
        self.friction = Friction(self.corrected, order, self.h)
        self.path = TorquePath(self.corrected, order, self.h)
        self.coupled = CoupledMotors(self.corrected, self.body, self.h)
        # with nothing between torque and bodies the engine steps on its own
        acts = self.friction.present or self.rotors.any() or self.loads.present
        own_motors = bool(self.motors.joints.any())
        self.direct = not (acts or own_motors or self.coupled.present)
