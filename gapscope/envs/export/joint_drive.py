"""What acts between the command and the body of each joint: nominal values and effects together, joint side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.passivity import total
from gapscope.envs.drive.substeps import least_inertia, mass_matrices
from gapscope.envs.drive.two_mass import teeth


class Ripple(NamedTuple):
    """A sin(n q + phi) at the coordinate q of the file: A [N m], n [1], phi [rad]."""

    amplitude: float
    cycles: float
    phase: float


class FrictionCurve(NamedTuple):
    """A torque [N m] and the speed [rad/s] over which it falls or grows; off if the torque is 0."""

    torque: float
    velocity: float


class Gear(NamedTuple):
    """What lies between motor and joint: k [N m/rad], d [N m s/rad], free play of the whole width w [rad].

    ``elastic`` says whether k and d are those of an effect, not of teeth in contact.
    """

    stiffness: float
    damping: float
    width: float
    elastic: bool


@dataclass(frozen=True)
class JointDrive:
    """What acts on one joint, nominal values and effects together, joint side.

    Attributes:
        damping: viscous friction [N m s/rad].
        friction: Coulomb friction [N m].
        stribeck: what dry friction is higher by at rest.
        saturating: what dry friction grows to in motion.
        presliding: distance over which dry friction builds up [rad], 0 if at once.
        armature: rotor inertia [kg m^2].
        inertia: smallest inertia that friction holds, however the other joints move [kg m^2].
        gear: between motor and joint, or ``None`` if they are one body.
        stiffness, rest: of the parallel spring [N m/rad], [rad].
        scale: share by which more torque arrives than is commanded [1].
        offset: torque that arrives beside it [N m].
        ripple: torque that arrives with the position.
        delay: time by which the torque arrives late [s].
        lag: time constant between the two [s].
        zero: what the encoder reads beyond the true position, by which the coordinate of the file is shifted [rad].
        effort: limit of the commanded torque [N m], or ``None`` if none is known.
        velocity: limit of the joint's velocity [rad/s], or ``None``.
    """

    damping: float
    friction: float
    stribeck: FrictionCurve
    saturating: FrictionCurve
    presliding: float
    armature: float
    inertia: float
    gear: Gear | None
    stiffness: float
    rest: float
    scale: float
    offset: float
    ripple: Ripple
    delay: float
    lag: float
    zero: float
    effort: float | None
    velocity: float | None


def joint_drives(corrected: CorrectedArm, body: RigidBody) -> dict[str, JointDrive]:
    """The drives of a corrected arm by name of the joint; ``body`` holds its changed bodies.

    Raises:
        InputError: friction or armature that is negative in total.
    """
    arm, value = corrected.arm, corrected.value
    armature = total(arm.armature + value("armature", "inertia"), "armature", "kg m^2")
    zero = value("encoder_offset", "offset")
    masses = mass_matrices(body)[:, body.places][:, :, body.places]
    gears = _gears(corrected, armature, least_inertia(masses))
    columns = {
        "damping": total(
            arm.viscous + value("viscous_friction", "coefficient"),
            "viscous_friction",
            "N m s/rad",
        ),
        "friction": total(
            arm.coulomb + value("coulomb_friction", "torque"), "coulomb_friction", "N m"
        ),
        "presliding": arm.presliding,
        "armature": armature,
        "inertia": _held_inertia(masses, armature, gears),
        "stiffness": value("parallel_spring", "stiffness"),
        "rest": value("parallel_spring", "rest") + zero,
        "scale": value("torque_scale", "scale"),
        "offset": value("torque_offset", "torque"),
        "delay": value("actuator_delay", "delay"),
        "lag": value("actuator_lag", "time_constant"),
        "zero": zero,
    }
    efforts = _efforts(corrected, body)
    velocities = body.velocity_limits()
    return {
        joint: JointDrive(
            **{name: float(column[j]) for name, column in columns.items()},
            stribeck=FrictionCurve(*_values(corrected, "stribeck_friction", j)),
            saturating=FrictionCurve(*_values(corrected, "saturating_friction", j)),
            gear=gears[j],
            ripple=_ripple(corrected, zero, j),
            effort=efforts[j],
            velocity=float(velocities[j]) if 0 < velocities[j] < np.inf else None,
        )
        for j, joint in enumerate(arm.joints)
    }


def _held_inertia(
    masses: np.ndarray, armature: np.ndarray, gears: list[Gear | None]
) -> np.ndarray:
    """Inertia [kg m^2], (n,), by which springs of any stiffness s on all joints are no faster than sqrt(s / inertia).

    Of motors and bodies whose mass matrices are of shape (K, n, n), without their rotors.
    """
    alone = np.array([gear is not None for gear in gears])
    together = masses + np.diag(np.where(alone, 0.0, armature))
    least = least_inertia(together)
    root = np.sqrt(least)
    # the largest eigenvalue of M^-1, with each joint's own least inertia as unit
    coupling = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(together) * root)
    return np.where(alone, armature, least / coupling.max())


def _values(corrected: CorrectedArm, name: str, j: int) -> tuple[float, float]:
    """Torque and velocity of a friction law at joint j from 0."""
    return (
        float(corrected.value(name, "torque")[j]),
        float(corrected.value(name, "velocity")[j]),
    )


def _ripple(corrected: CorrectedArm, zero: np.ndarray, j: int) -> Ripple:
    """Ripple of joint j from 0, which follows the true position whatever the encoder reads."""
    a, n, phi = (
        float(corrected.value("torque_ripple", name)[j])
        for name in ("amplitude", "cycles", "phase")
    )
    return Ripple(a, n, phi - n * float(zero[j]))


def _efforts(corrected: CorrectedArm, body: RigidBody) -> list[float | None]:
    """The lowest known limit of each joint's commanded torque [N m]."""
    limit = corrected.arm.torque_limit
    nominal = body.effort_limits() if limit is None else limit
    saturated = corrected.value("torque_saturation", "limit")
    out = []
    for pair in zip(nominal.tolist(), saturated.tolist(), strict=True):
        known = [x for x in pair if 0 < x < np.inf]
        out.append(min(known, default=None))
    return out


def _gears(
    corrected: CorrectedArm, armature: np.ndarray, inertia: np.ndarray
) -> list[Gear | None]:
    """Gears of the joints; ``None`` where nothing yields, or where no rotor is known that could turn on its own."""
    stiffness = corrected.value("joint_elasticity", "stiffness")
    damping = corrected.value("joint_elasticity", "damping")
    width = corrected.value("backlash", "width")
    tooth_stiffness, tooth_damping = teeth(armature, inertia)
    gears: list[Gear | None] = []
    for j, k in enumerate(stiffness.tolist()):
        if armature[j] <= 0 or not (k > 0 or width[j] > 0):
            gears.append(None)
        elif k > 0:
            gears.append(Gear(k, float(damping[j]), float(width[j]), True))
        else:
            k, d = float(tooth_stiffness[j]), float(tooth_damping[j])
            gears.append(Gear(k, d, float(width[j]), False))
    return gears
