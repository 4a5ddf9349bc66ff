"""What acts between the command and the body of each joint: nominal values and effects together, joint side."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import QUANTITIES
from gapscope.effects.passivity import total
from gapscope.envs.drive.substeps import least_inertia, mass_matrices
from gapscope.envs.drive.two_mass import teeth

NOT_NEGATIVE = {"friction": "N m", "damping": "N m s/rad", "rotor": "kg m^2"}
"""Quantities that may not be negative in total, with their unit."""


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

    Quantities have the names and units of ``gapscope.effects.effect.QUANTITIES``; ``rest`` and ``ripple_phase`` hold at
    the coordinate of the file, which is what the encoder reads.

    Attributes:
        presliding: distance over which dry friction builds up [rad], 0 if at once.
        inertia: smallest inertia that friction holds, however the other joints move [kg m^2].
        gear: between motor and joint, or ``None`` if they are one body.
        effort: lowest known limit of the commanded torque [N m], infinite if none is known.
        velocity: limit of the joint's velocity [rad/s], infinite if none is known.
    """

    friction: float
    damping: float
    rotor: float
    breakaway: float
    breakaway_speed: float
    saturating: float
    saturating_speed: float
    stiffness: float
    rest: float
    delay: float
    lag: float
    scale: float
    offset: float
    ripple: float
    ripple_cycles: float
    ripple_phase: float
    zero: float
    presliding: float
    inertia: float
    gear: Gear | None
    effort: float
    velocity: float


def joint_drives(corrected: CorrectedArm, body: RigidBody) -> dict[str, JointDrive]:
    """The drives of a corrected arm by name of the joint; ``body`` holds its changed bodies.

    Raises:
        InputError: friction or rotor inertia that is negative in total.
    """
    arm = corrected.arm
    names = [field.name for field in fields(JointDrive)]
    columns = {x: corrected.quantity(x) for x in names if x in QUANTITIES}
    columns |= {name: passive_quantity(corrected, name) for name in NOT_NEGATIVE}
    # springs and ripple follow the true position, the coordinates of a file are what the encoders read
    zero = columns["zero"]
    columns["rest"] = columns["rest"] + zero
    columns["ripple_phase"] = columns["ripple_phase"] - columns["ripple_cycles"] * zero
    masses = mass_matrices(body)[:, body.places][:, :, body.places]
    gears = _gears(corrected, columns["rotor"], least_inertia(masses))
    limit = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
    columns |= {
        "presliding": arm.presliding,
        "inertia": _held_inertia(masses, columns["rotor"], gears),
        "effort": np.minimum(_known(limit), _known(corrected.quantity("limit"))),
        "velocity": _known(body.velocity_limits()),
    }
    return {
        joint: JointDrive(
            gear=gears[j],
            **{name: float(column[j]) for name, column in columns.items()},
        )
        for j, joint in enumerate(arm.joints)
    }


def passive_quantity(corrected: CorrectedArm, name: str, of: str = "") -> np.ndarray:
    """A quantity that may not be negative in total, of joints or, with ``of="motor_"``, of coupled motors, (n,).

    Raises:
        InputError: it is negative.
    """
    return total(corrected.quantity(of + name), of + name, NOT_NEGATIVE[name])


def _known(limit: np.ndarray) -> np.ndarray:
    """Limits, infinite where none is known."""
    return np.where(limit > 0, limit, np.inf)


def _held_inertia(
    masses: np.ndarray, rotors: np.ndarray, gears: list[Gear | None]
) -> np.ndarray:
    """Inertia [kg m^2], (n,), by which springs of any stiffness s on all joints are no faster than sqrt(s / inertia).

    Of motors and bodies whose mass matrices are of shape (K, n, n), without their rotors.
    """
    alone = np.array([gear is not None for gear in gears])
    together = masses + np.diag(np.where(alone, 0.0, rotors))
    least = least_inertia(together)
    root = np.sqrt(least)
    # the largest eigenvalue of M^-1, with each joint's own least inertia as unit
    coupling = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(together) * root)
    return np.where(alone, rotors, least / coupling.max())


def _gears(
    corrected: CorrectedArm, rotors: np.ndarray, inertia: np.ndarray
) -> list[Gear | None]:
    """Gears of the joints; ``None`` where nothing yields, or where no rotor is known that could turn on its own."""
    stiffness, damping, width = (
        corrected.quantity(name) for name in ("gear_stiffness", "gear_damping", "play")
    )
    elastic = stiffness > 0
    tooth_stiffness, tooth_damping = teeth(rotors, inertia)
    stiffness = np.where(elastic, stiffness, tooth_stiffness)
    damping = np.where(elastic, damping, tooth_damping)
    return [
        Gear(float(stiffness[j]), float(damping[j]), float(width[j]), bool(elastic[j]))
        if rotors[j] > 0 and (elastic[j] or width[j] > 0)
        else None
        for j in range(len(rotors))
    ]
