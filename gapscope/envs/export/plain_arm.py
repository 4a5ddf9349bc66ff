"""What a file for another simulator is written from: the bodies of a corrected arm, and the drive of each joint.

A drive is what acts between the command and the body of a joint, nominal values and effects together, joint side.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_shapes import (
    Frame,
    PlacedShape,
    read_frames,
    read_shapes,
)
from gapscope.arm.dynamics.plain_urdf import (
    Link,
    check_inertia,
    link_name,
    moving_links,
    rotation,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import QUANTITIES, LinkChange
from gapscope.effects.passivity import total
from gapscope.envs.drive.two_mass import least_inertia, mass_matrices, teeth

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


@dataclass(frozen=True)
class PlainArm:
    """A corrected arm as bodies and drives.

    Attributes:
        corrected: the arm that it was made from.
        nominal: the bodies of the nominal arm.
        body: the bodies of the corrected arm.
        links: the moving bodies, parents before children; their joints' coordinates are what the encoders read.
        drives: by name of the joint.
        mount: R from the base to a world whose gravity points along -z, shape (3, 3): the orientation of the base, with
            tilt.
        gravity: strength of gravity [m/s^2].
        frames: links of the URDF by name, empty of an MJCF file.
        shapes: shapes of the URDF.
        missing: a sentence for each shape that cannot be used.
    """

    corrected: CorrectedArm
    nominal: RigidBody
    body: RigidBody
    links: tuple[Link, ...]
    drives: dict[str, JointDrive]
    mount: np.ndarray
    gravity: float
    frames: dict[str, Frame]
    shapes: tuple[PlacedShape, ...]
    missing: tuple[str, ...]

    def body_name(self, joint: str) -> str:
        """Name of the body that a joint moves, the base for an empty string: its link's in the URDF.

        No body is called ``world``, which means what does not move in other formats.
        """
        own = (
            frame.name
            for frame in self.frames.values()
            if frame.joint == joint
            and frame.name != "world"
            and not frame.position.any()
            and _none(frame.rotation)
        )
        return next(own, link_name(joint))

    @property
    def upright(self) -> bool:
        """Whether the base is oriented like the world."""
        return _none(self.mount)


def plain_arm(corrected: CorrectedArm) -> PlainArm:
    """The bodies and drives of a corrected arm.

    Raises:
        InputError: an effect on a joint that does not exist, friction or armature that is negative in total, or bodies
            that no torque can move.
    """
    corrected.check()
    nominal = RigidBody(corrected.arm)
    body = corrected.body(nominal)
    check_inertia(
        body,
        ", ".join(
            e.name for e in corrected.effects if isinstance(e.effect, LinkChange)
        ),
    )
    strength = float(np.linalg.norm(corrected.arm.gravity))
    shapes, missing = read_shapes(body)
    drives = joint_drives(corrected, body)
    links = tuple(_shifted(x, drives[x.joint].zero) for x in moving_links(body))
    return PlainArm(
        corrected,
        nominal,
        body,
        links,
        drives,
        upright(corrected.arm.gravity) @ corrected.base_rotation(),
        strength,
        read_frames(body),
        shapes,
        missing,
    )


def upright(gravity: np.ndarray) -> np.ndarray:
    """R of the smallest turn with R g = (0, 0, -|g|), shape (3, 3); the identity without gravity g [m/s^2], (3,)."""
    strength = float(np.linalg.norm(gravity))
    if strength == 0:
        return np.eye(3)
    down, goal = np.asarray(gravity) / strength, np.array([0.0, 0.0, -1.0])
    axis = np.cross(down, goal)
    if np.linalg.norm(axis) < 1e-12:
        return np.eye(3) if down[2] < 0 else np.diag([1.0, -1.0, -1.0])
    angle = np.arctan2(np.linalg.norm(axis), down @ goal)
    return np.asarray(
        Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    )


def _shifted(link: Link, zero: float) -> Link:
    """A body whose joint coordinate is the true one plus ``zero`` [rad or m]: the same place, reached further on."""
    if zero == 0:
        return link
    place, turn = link.origin[0], rotation(link.origin)
    if link.kind == "revolute":
        turn = turn @ Rotation.from_rotvec(-zero * link.axis).as_matrix()
    else:
        place = place - zero * turn @ link.axis
    limits = link.limits
    if limits is not None:
        limits = (limits[0] + zero, limits[1] + zero)
    angles = Rotation.from_matrix(turn).as_euler("xyz")
    return replace(link, origin=(place, angles), limits=limits)


def _none(turn: np.ndarray) -> bool:
    """Whether a rotation is the identity."""
    return bool(np.abs(turn - np.eye(3)).max() < 1e-12)


def mesh_path(mesh: Path, out: Path, relative: bool) -> str:
    """How a file ``out`` names a mesh: from its own folder, or absolutely."""
    if not relative:
        return mesh.resolve().as_posix()
    return Path(os.path.relpath(mesh.resolve(), out.resolve().parent)).as_posix()
