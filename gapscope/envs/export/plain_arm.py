"""What a file for another simulator is written from: the bodies of a corrected arm, their joints and drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_shapes import Frame, Shape, read_frames, read_shapes
from gapscope.arm.dynamics.plain_urdf import (
    Link,
    check_inertia,
    link_name,
    moving_links,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.envs.drive.friction import total


@dataclass(frozen=True)
class JointDrive:
    """What acts on one joint, nominal values and effects together, joint side.

    Attributes:
        damping: viscous friction [N m s/rad].
        friction: Coulomb friction [N m].
        armature: rotor inertia [kg m^2].
        stiffness, rest: of the parallel spring [N m/rad], [rad].
        scale: share by which more torque arrives than is commanded [1].
        offset: torque that arrives beside it [N m].
        lag: time constant between the two [s].
        effort: limit of the commanded torque [N m], or ``None`` if none is known.
        velocity: limit of the joint's velocity [rad/s], or ``None``.
    """

    damping: float
    friction: float
    armature: float
    stiffness: float
    rest: float
    scale: float
    offset: float
    lag: float
    effort: float | None
    velocity: float | None


@dataclass(frozen=True)
class PlainArm:
    """A corrected arm as bodies and drives.

    Attributes:
        corrected: the arm that it was made from.
        nominal: the bodies of the nominal arm.
        body: the bodies of the corrected arm.
        links: the moving bodies, parents before children.
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
    return PlainArm(
        corrected,
        nominal,
        body,
        moving_links(body),
        joint_drives(corrected, body),
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


def joint_drives(corrected: CorrectedArm, body: RigidBody) -> dict[str, JointDrive]:
    """Drives by name of the joint.

    Raises:
        InputError: friction or armature is negative in total.
    """
    arm, value = corrected.arm, corrected.value
    columns = {
        "damping": total(
            arm.viscous + value("viscous_friction", "coefficient"),
            "viscous_friction",
            "N m s/rad",
        ),
        "friction": total(
            arm.coulomb + value("coulomb_friction", "torque"), "coulomb_friction", "N m"
        ),
        "armature": total(
            arm.armature + value("armature", "inertia"), "armature", "kg m^2"
        ),
        "stiffness": value("parallel_spring", "stiffness"),
        "rest": value("parallel_spring", "rest"),
        "scale": value("torque_scale", "scale"),
        "offset": value("torque_offset", "torque"),
        "lag": value("actuator_lag", "time_constant"),
    }
    efforts = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
    saturated, velocities = value("torque_saturation", "limit"), body.velocity_limits()
    return {
        joint: JointDrive(
            **{name: float(column[j]) for name, column in columns.items()},
            effort=min(
                (x for x in (efforts[j], saturated[j]) if 0 < x < np.inf), default=None
            ),
            velocity=float(velocities[j]) if 0 < velocities[j] < np.inf else None,
        )
        for j, joint in enumerate(arm.joints)
    }


def _none(rotation: np.ndarray) -> bool:
    """Whether a rotation is the identity."""
    return bool(np.abs(rotation - np.eye(3)).max() < 1e-12)
