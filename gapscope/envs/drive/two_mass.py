"""Joints with two masses: motor and link, between them a spring, a damper and free play.

A time step is divided into as many parts as it takes to follow springs in and beside the joints.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.transmission import (
    backlash_deflection,
    elastic_deflection,
    elastic_torque,
    through_backlash,
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
        if rigid_gear.any():
            tooth_stiffness, tooth_damping = teeth(inertia, link_inertia)
            k = np.where(rigid_gear, tooth_stiffness, k)
            d = np.where(rigid_gear, tooth_damping, d)
        self.stiffness, self.damping = k, d
        self._rigid = ~self.joints
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
        moving = np.abs(momentum)
        moving -= dt * limit
        np.copysign(np.maximum(moving, 0.0, out=moving), momentum, self.velocity)
        self.velocity /= self._inertia + dt * viscous
        self.position += dt * self.velocity

    def follow(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Motors of rigid joints are where the joints are."""
        np.copyto(self.position, q, where=self._rigid)
        np.copyto(self.velocity, dq, where=self._rigid)


POSTURES = 12
"""Postures of the arm at which its inertia is looked at, the straight one among them."""


def mass_matrices(body: RigidBody) -> np.ndarray:
    """Mass matrices over postures within the limits [kg m^2], shape (POSTURES, n, n), joints in kinematic order."""
    low, high = body.position_limits()
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    share = np.random.default_rng(0).uniform(size=(POSTURES - 1, body.n_joints))
    postures = np.vstack([np.zeros(body.n_joints), low + share * (high - low)])
    return np.array([body.mass_matrix(q)[body.order][:, body.order] for q in postures])


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
    on_motors = np.diag(np.where(elastic, rotors, 1.0))
    for mass in masses:
        on_links = mass + np.diag(np.where(elastic, 0.0, rotors))
        root = np.linalg.inv(np.linalg.cholesky(block_diag(on_links, on_motors)))
        for inside, values, beside, power in kinds:
            k = np.diag(np.where(elastic, values, 0.0))
            whole = np.block([[k + np.diag(beside), -k], [-k, k]])
            rates, modes = np.linalg.eigh(root @ whole @ root.T)
            if rates[-1] ** power > worst:
                worst = float(rates[-1] ** power)
                shape = np.abs(root.T @ modes[:, -1])
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
