"""What a file for another simulator is written from: the bodies of a corrected arm, their joints and drives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_shapes import Frame, Shape, read_frames, read_shapes
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
from gapscope.envs.export.joint_drive import JointDrive, joint_drives


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
    shapes: tuple[Shape, ...]
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
