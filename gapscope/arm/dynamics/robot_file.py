"""A robot from a URDF or an MJCF file, checked, as pinocchio has it."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics import mjcf
from gapscope.arm.dynamics.inertials import check_inertials
from gapscope.arm.dynamics.mjcf import (
    check_mjcf,
    check_references,
    left_out,
    name_bodies,
    torque_limits,
)
from gapscope.arm.errors import InputError, ModelWarning


def build(path: Path) -> pin.Model:
    """The robot of a file, with its torque limits.

    Raises:
        InputError: there is no such file, it is no robot, or a body of it is none that can be.
    """
    root = _root(path)
    check_inertials(root, path)
    try:
        if root.tag == "robot":
            return pin.buildModelFromXML(_urdf_text(root))
        check_mjcf(root, path)
        model = _of_mjcf(root)
    except IndexError:
        raise InputError(
            "names a default class that it does not have",
            "correct class or childclass",
            file=path,
        ) from None
    except (ValueError, RuntimeError) as error:
        raise InputError(f"cannot be read as a robot ({error})", file=path) from None
    for joint, limit in torque_limits(root, path).items():
        if model.existJointName(joint):
            model.effortLimit[model.joints[model.getJointId(joint)].idx_v] = limit
    return model


def arm_model(
    path: Path, joints: Sequence[str], gravity: Sequence[float] | np.ndarray
) -> pin.Model:
    """Model of some joints of a file: the others are locked at zero, without armature, under a gravity [m/s^2].

    Raises:
        InputError: the file lacks one of the joints, or has one with more than one degree of freedom.
    """
    full = build(path)
    names = list(full.names)[1:]
    missing = [name for name in joints if name not in names]
    if missing:
        raise InputError(
            f"has no movable joint {', '.join(missing)}; it has {', '.join(names)}",
            "name the joints of the recording's columns in joints:, or give the URDF of the recorded arm",
            file=path,
        )
    locked = [full.getJointId(name) for name in names if name not in joints]
    model = full
    if locked:
        model = pin.buildReducedModel(full, locked, np.zeros(full.nq))
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    model.armature = np.zeros(model.nv)
    if model.nq != model.nv or model.nv != len(joints):
        raise InputError("has joints with more than one degree of freedom", file=path)
    return model


def actuated_joints(path: Path) -> list[str]:
    """Names of the movable joints of a URDF or MJCF file in kinematic order."""
    return list(build(path).names)[1:]


def mjcf_entries(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Content of an MJCF file beyond the bodies, as fields of ``NominalArm``; nothing for a URDF.

    armature [kg m^2], coulomb [N m] (its ``frictionloss``) and viscous [N m s/rad] (its ``damping``), each (n,), and
    gravity [m/s^2], (3,), where it is given. A ``ModelWarning`` names what is left out.

    Raises:
        InputError: positions of one of the joints do not count from the pose that the file draws.
    """
    root = _root(path)
    if root.tag == "robot":
        return {}
    check_references(root, path, joints)
    for note in left_out(root, path, joints):
        warnings.warn(note, ModelWarning, stacklevel=3)
    model = build(path)
    columns = [model.joints[model.getJointId(name)].idx_v for name in joints]
    values = {
        "armature": model.armature,
        "coulomb": model.upperDryFrictionLimit,
        "viscous": model.damping,
    }
    entries = {name: np.array(value)[columns] for name, value in values.items()}
    down = mjcf.gravity(root, path)
    return entries if down is None else {**entries, "gravity": down}


def _root(path: Path) -> ET.Element:
    """Root element of a URDF, <robot>, or of an MJCF file, <mujoco>."""
    try:
        root = ET.parse(path).getroot()
    except FileNotFoundError:
        raise InputError(
            "no such file", "check the robot: entry of the case", file=path
        ) from None
    except ET.ParseError as error:
        raise InputError(
            f"is not valid XML ({error})",
            "give a complete URDF or MJCF file; was it cut short?",
            file=path,
        ) from None
    if root.tag not in ("robot", "mujoco"):
        raise InputError(
            f"root element is <{root.tag}>, expected <robot> or <mujoco>",
            "give a URDF or MJCF file",
            file=path,
        )
    return root


def _of_mjcf(root: ET.Element) -> pin.Model:
    """The model of an MJCF file whose bodies all have a name; pinocchio reads files only."""
    name_bodies(root)
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
        return pin.buildModelFromMJCF(str(file))


def _urdf_text(root: ET.Element) -> str:
    """URDF as text, with continuous joints turned into revolute ones (pinocchio would give them two coordinates)."""
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e9")
            limit.set("upper", "1e9")
    return ET.tostring(root, encoding="unicode")
