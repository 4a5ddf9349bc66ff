"""What a file for another simulator is written from: the bodies of a corrected arm, and the drive of each joint.

A drive is what acts between the command and the body of a joint, nominal values and effects together, joint side.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
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
from gapscope.effects.effect import LinkChange
from gapscope.envs.drive.arm_drive import least_inertia, mass_matrices, teeth

PASSIVE = ("friction", "damping", "rotor")
"""Quantities of a drive that may not be negative in total."""
DRIVEN = (
    *("breakaway", "breakaway_speed", "saturating", "saturating_speed"),
    *("stiffness", "rest", "delay", "lag", "scale", "offset", "zero"),
    *("ripple", "ripple_cycles", "ripple_phase"),
    *("gear_stiffness", "gear_damping", "play"),
)
"""The other quantities of a drive."""


def joint_drives(corrected: CorrectedArm, body: RigidBody) -> pd.DataFrame:
    """The drives of a corrected arm, a row for each joint by its name.

    Columns are quantities with the names and units of ``gapscope.effects.effect.QUANTITIES``, nominal values and
    effects together, joint side; ``rest`` and ``ripple_phase`` hold at the coordinate of the file, which is what the
    encoder reads. Beside them:

    - presliding: distance over which dry friction builds up [rad], 0 if at once;
    - inertia: smallest inertia that friction holds, however the other joints move [kg m^2];
    - gear: whether something yields between the joint and a motor of its own, whose rotor is known;
    - elastic: whether stiffness and damping of the gear are those of an effect, not of teeth in contact;
    - effort, velocity: lowest known limits of the commanded torque [N m] and of the velocity [rad/s], or infinite.

    Args:
        corrected: the arm.
        body: its changed bodies.

    Raises:
        InputError: friction or rotor inertia that is negative in total.
    """
    arm = corrected.arm
    drives = pd.DataFrame(index=list(arm.joints))
    for name in PASSIVE:
        drives[name] = corrected.passive(name)
    for name in DRIVEN:
        drives[name] = corrected.quantity(name)
    # springs and ripple follow the true position, the coordinates of a file are what the encoders read
    drives["rest"] += drives["zero"]
    drives["ripple_phase"] -= drives["ripple_cycles"] * drives["zero"]
    masses = mass_matrices(body)[:, body.places][:, :, body.places]
    rotors = drives["rotor"].to_numpy()
    drives["elastic"] = drives["gear_stiffness"] > 0
    drives["gear"] = (rotors > 0) & (drives["elastic"] | (drives["play"] > 0))
    names = ("gear_stiffness", "gear_damping")
    for name, value in zip(names, teeth(rotors, least_inertia(masses)), strict=True):
        drives[name] = drives[name].where(drives["elastic"], value)
    limit = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
    drives["presliding"] = arm.presliding
    # springs of any stiffness s on all joints are no faster than sqrt(s / inertia): with each joint's own least inertia
    # as unit, the largest eigenvalue of M^-1 of the bodies and the motors that are not behind a gear
    alone = drives["gear"].to_numpy()
    together = masses + np.diag(np.where(alone, 0.0, rotors))
    least = least_inertia(together)
    root = np.sqrt(least)
    coupling = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(together) * root)
    drives["inertia"] = np.where(alone, rotors, least / coupling.max())
    drives["effort"] = np.minimum(_known(limit), _known(corrected.quantity("limit")))
    drives["velocity"] = _known(body.velocity_limits())
    return drives


def _known(limit: np.ndarray) -> np.ndarray:
    """Limits, infinite where none is known."""
    return np.where(limit > 0, limit, np.inf)


class PlainArm(NamedTuple):
    """A corrected arm as bodies and drives.

    Attributes:
        corrected: the arm that it was made from.
        nominal: the bodies of the nominal arm.
        body: the bodies of the corrected arm.
        links: the moving bodies, parents before children; their joints' coordinates are what the encoders read.
        drives: see ``joint_drives``.
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
    drives: pd.DataFrame
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
    links = tuple(
        _shifted(x, float(drives.at[x.joint, "zero"])) for x in moving_links(body)
    )
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
