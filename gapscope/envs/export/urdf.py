"""A corrected arm as URDF: that of the nominal arm with other inertials, friction and limits, or one of its bodies."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.description import SCHEMES, find_mesh, read_description
from gapscope.arm.dynamics.inertials import (
    own_parameters,
    possible,
    set_parameters,
)
from gapscope.arm.dynamics.plain_urdf import numbers, plain_urdf
from gapscope.envs.export.plain_arm import PlainArm, mesh_path

MOVABLE = ("revolute", "continuous", "prismatic", "floating", "planar")
"""Types of joints that move."""
LIMITS = (
    ("limit", "lower"),
    ("limit", "upper"),
    ("safety_controller", "soft_lower_limit"),
    ("safety_controller", "soft_upper_limit"),
)
"""Elements and attributes that hold a position of a joint."""


def as_urdf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as URDF, and what else is left out.

    Joints that are not the arm's are fixed where its model has them locked. The base is turned by a fixed joint on a
    link of its own. Of an arm from an MJCF file the moving bodies alone are written.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.
    """
    root = ET.parse(arm.body.file).getroot()
    notes: tuple[str, ...] = ()
    if root.tag == "robot":
        notes = (*_fix_others(root, arm), *_name_meshes(root, arm, out, relative))
        _set_bodies(root, arm)
        _shift_zeros(root, arm)
    else:
        root = ET.fromstring(plain_urdf(arm.links))
        root.set("name", arm.corrected.arm.name)
        for link, inertia in zip(
            arm.links,
            (arm.body.model.inertias[k + 1] for k in range(len(arm.links))),
            strict=True,
        ):
            element = next(
                x for x in root.findall("link") if x.get("name") == f"{link.joint}_link"
            )
            set_parameters(element, inertia.toDynamicParameters())
    for joint in root.findall("joint"):
        if joint.get("name") in arm.drives.index:
            _set_drive(joint, arm.drives.loc[joint.get("name")])
    if not arm.upright:
        _turn_base(root, arm.mount)
    return ET.tostring(root, encoding="unicode"), notes


def _fix_others(root: ET.Element, arm: PlainArm) -> tuple[str, ...]:
    """Fix joints that are not the arm's; says which."""
    fixed = []
    for joint in root.findall("joint"):
        if joint.get("type") in MOVABLE and joint.get("name") not in arm.drives.index:
            fixed.append(joint.get("name", ""))
            position = arm.corrected.arm.locked.get(joint.get("name", ""), 0.0)
            _set_origin(joint, position)
            joint.set("type", "fixed")
            for element in list(joint):
                if element.tag not in ("origin", "parent", "child"):
                    joint.remove(element)
    return (
        (
            f"motion of {', '.join(fixed)}: not among the joints of the arm, fixed where they are locked",
        )
        if fixed
        else ()
    )


def _set_origin(joint: ET.Element, position: float) -> None:
    """Move the origin of a joint to where it takes its link at a position [rad or m]."""
    if position == 0:
        return
    origin, axis = joint.find("origin"), joint.find("axis")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    direction = _vector(axis, "xyz", "1 0 0")
    direction = direction / np.linalg.norm(direction)
    turn = Rotation.from_euler("xyz", _vector(origin, "rpy", "0 0 0"))
    place = _vector(origin, "xyz", "0 0 0")
    if joint.get("type") == "prismatic":
        place = place + turn.apply(position * direction)
    else:
        turn = turn * Rotation.from_rotvec(position * direction)
    origin.set("xyz", numbers(place))
    origin.set("rpy", numbers(turn.as_euler("xyz")))


def _vector(element: ET.Element | None, key: str, otherwise: str) -> np.ndarray:
    text = None if element is None else element.get(key)
    return np.array((text or otherwise).split(), dtype=float)


def _name_meshes(
    root: ET.Element, arm: PlainArm, out: Path, relative: bool
) -> tuple[str, ...]:
    """Let meshes and textures be found from the new place; says which textures are not found.

    A shape whose mesh is not there is removed, since simulators refuse the file; a name in a package is kept, which may
    be elsewhere.
    """
    missing = []
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            name = "" if mesh is None else mesh.get("filename", "")
            lost = mesh is not None and find_mesh(name, arm.body.file) is None
            if lost and not name.startswith(SCHEMES):
                link.remove(shape)
    for element in (*root.iter("mesh"), *root.iter("texture")):
        name = element.get("filename", "")
        found = find_mesh(name, arm.body.file)
        if found is not None:
            element.set("filename", mesh_path(found, out, relative))
        elif element.tag == "texture":
            missing.append(f"the texture {name}: it is not found, its name is kept")
    return tuple(dict.fromkeys(missing))


def _set_bodies(root: ET.Element, arm: PlainArm) -> None:
    """Add the changes of inertia to the links that the joints move.

    A link that alone could not lose so much takes over the inertia of what is fixed to it.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    child = {j.get("name", ""): _end(j, "child") for j in root.findall("joint")}
    described = read_description(arm.body.file, shapes=False).by_name
    increments = arm.corrected.inertial_increments(arm.nominal)
    merged = arm.body.inertial_parameters().reshape(-1, 10)
    for joint, increment, total in zip(
        arm.corrected.arm.joints, increments, merged, strict=True
    ):
        if not increment.any():
            continue
        link = links[child[joint]]
        alone = own_parameters(described[child[joint]].inertial) + increment
        if possible(alone) or not possible(total):
            set_parameters(link, alone)
            continue
        for name, frame in arm.frames.items():
            if frame.joint == joint and name in links:
                set_parameters(links[name], np.zeros(10))
        set_parameters(link, total)


def _set_drive(joint: ET.Element, drive: pd.Series) -> None:
    """Friction and limits of a joint."""
    dynamics = joint.find("dynamics")
    dynamics = ET.SubElement(joint, "dynamics") if dynamics is None else dynamics
    dynamics.set("damping", repr(float(drive.damping)))
    dynamics.set("friction", repr(float(drive.friction)))
    limit = joint.find("limit")
    limit = (
        ET.SubElement(joint, "limit", effort="0", velocity="0")
        if limit is None
        else limit
    )
    if drive.effort < np.inf:
        limit.set("effort", repr(float(drive.effort)))
    if drive.velocity < np.inf:
        limit.set("velocity", repr(float(drive.velocity)))


def _shift_zeros(root: ET.Element, arm: PlainArm) -> None:
    """Let the coordinates of the joints be what their encoders read, the true ones plus a zero [rad or m]."""
    zeros = arm.drives["zero"]
    for joint in root.findall("joint"):
        zero = float(zeros.get(joint.get("name"), 0.0))
        if zero == 0:
            continue
        _set_origin(joint, -zero)
        for tag, name in LIMITS:
            element = joint.find(tag)
            limit = None if element is None else element.get(name)
            if element is not None and limit is not None:
                element.set(name, repr(float(limit) + zero))


def _turn_base(root: ET.Element, mount: np.ndarray) -> None:
    """A fixed joint between a new root link and the base."""
    links, joints = (
        [x.get("name", "") for x in root.findall(tag)] for tag in ("link", "joint")
    )
    carried = {_end(joint, "child") for joint in root.findall("joint")}
    base = next(name for name in links if name not in carried)
    world, holder = "world", "mount"
    while world in (*links, *joints):
        world += "_"
    while holder in (*links, *joints):
        holder += "_"
    joint = ET.Element("joint", name=holder, type="fixed")
    ET.SubElement(joint, "parent", link=world)
    ET.SubElement(joint, "child", link=base)
    ET.SubElement(
        joint,
        "origin",
        xyz="0 0 0",
        rpy=numbers(Rotation.from_matrix(mount).as_euler("xyz")),
    )
    root.insert(0, ET.Element("link", name=world))
    root.insert(1, joint)


def _end(joint: ET.Element, tag: str) -> str:
    """Link at an end of a joint."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
