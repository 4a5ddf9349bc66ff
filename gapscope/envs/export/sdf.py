"""A corrected arm as SDF 1.6: a model of moving bodies on a base that is fixed to the world."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_shapes import Shape
from gapscope.arm.dynamics.plain_urdf import Link, numbers, rotation
from gapscope.envs.export.heading import mesh_path
from gapscope.envs.export.plain_arm import PlainArm

NO_LIMIT = 1e16
"""Limit of a joint that has none, as the format has it."""


def as_sdf(
    arm: PlainArm, out: Path, relative: bool
) -> tuple[ET.Element, tuple[str, ...]]:
    """The arm as SDF, and what else is left out.

    Poses of links are those of all joints at zero, in the world, in which the base is turned as it stands; axes are in
    the frames of the links that they move. Links that are fixed to another are merged into it.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.
    """
    root = ET.Element("sdf", version="1.6")
    model = ET.SubElement(root, "model", name=arm.corrected.arm.name)
    base = ET.SubElement(model, "link", name=arm.body_name(""))
    _text(base, "pose", _pose(np.zeros(3), arm.mount))
    _add_inertial(
        base, 1.0, np.zeros(3), np.eye(3)
    )  # which a fixed base makes irrelevant, and readers miss
    fixed = ET.SubElement(model, "joint", name="fixed_to_world", type="fixed")
    _text(fixed, "parent", "world")
    _text(fixed, "child", arm.body_name(""))
    bodies, places = {"": base}, {"": (np.zeros(3), arm.mount)}
    for link in arm.links:
        position, turn = places[link.parent]
        places[link.joint] = (
            position + turn @ link.origin[0],
            turn @ rotation(link.origin),
        )
        bodies[link.joint] = _add_link(model, link, arm, places[link.joint])
        _add_joint(model, link, arm)
    for number, shape in enumerate(arm.shapes):
        _add_shape(bodies[shape.frame.joint], shape, number, out, relative)
    merged = [f.name for f in arm.frames.values() if f.name != arm.body_name(f.joint)]
    notes = (
        (f"frames of {', '.join(merged)}: merged into the links that carry them",)
        if merged
        else ()
    )
    return root, notes


def _add_link(
    model: ET.Element, link: Link, arm: PlainArm, place: tuple[np.ndarray, np.ndarray]
) -> ET.Element:
    """A moving body."""
    body = ET.SubElement(model, "link", name=arm.body_name(link.joint))
    _text(body, "pose", _pose(*place))
    axes = rotation(link.inertial)
    _add_inertial(
        body, link.mass, link.inertial[0], axes @ np.diag(link.moments) @ axes.T
    )
    return body


def _add_inertial(
    body: ET.Element, mass: float, centre: np.ndarray, tensor: np.ndarray
) -> None:
    """Mass [kg], its centre [m], (3,), and the tensor about it [kg m^2], (3, 3), both along the link's axes."""
    inertial = ET.SubElement(body, "inertial")
    _text(inertial, "pose", _pose(centre, np.eye(3)))
    _text(inertial, "mass", repr(mass))
    inertia = ET.SubElement(inertial, "inertia")
    names = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    for name, at in names.items():
        _text(inertia, name, repr(float(tensor[at])))


def _add_joint(model: ET.Element, link: Link, arm: PlainArm) -> None:
    """The joint that moves a body, with limits, friction and spring."""
    drive = arm.drives[link.joint]
    joint = ET.SubElement(model, "joint", name=link.joint, type=link.kind)
    _text(joint, "parent", arm.body_name(link.parent))
    _text(joint, "child", arm.body_name(link.joint))
    axis = ET.SubElement(joint, "axis")
    _text(axis, "xyz", numbers(link.axis))
    limit = ET.SubElement(axis, "limit")
    low, high = link.limits or (-NO_LIMIT, NO_LIMIT)
    values = {
        "lower": low,
        "upper": high,
        "effort": drive.effort,
        "velocity": drive.velocity,
    }
    for name, value in values.items():
        if value < np.inf:
            _text(limit, name, repr(float(value)))
    dynamics = ET.SubElement(axis, "dynamics")
    _text(dynamics, "damping", repr(drive.damping))
    _text(dynamics, "friction", repr(drive.friction))
    if drive.stiffness:
        _text(dynamics, "spring_reference", repr(drive.rest))
        _text(dynamics, "spring_stiffness", repr(drive.stiffness))


def _add_shape(
    body: ET.Element, shape: Shape, number: int, out: Path, relative: bool
) -> None:
    """A shape of a body."""
    element = ET.SubElement(body, shape.use, name=f"{shape.use}_{number}")
    _text(element, "pose", _pose(shape.frame.position, shape.frame.rotation))
    form = ET.SubElement(ET.SubElement(element, "geometry"), shape.kind)
    if shape.mesh is not None:
        _text(form, "uri", mesh_path(shape.mesh, out, relative))
        _text(form, "scale", numbers(np.array(shape.size)))
    elif shape.kind == "box":
        _text(form, "size", numbers(np.array(shape.size)))
    else:
        for name, value in zip(("radius", "length"), shape.size, strict=False):
            _text(form, name, repr(value))
    if shape.use == "visual" and shape.colour is not None:
        material = ET.SubElement(element, "material")
        for name in ("ambient", "diffuse"):
            _text(material, name, numbers(np.array(shape.colour)))


def _pose(position: np.ndarray, turn: np.ndarray) -> str:
    """Position [m] and roll, pitch, yaw [rad]."""
    return numbers(
        np.concatenate([position, Rotation.from_matrix(turn).as_euler("xyz")])
    )


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text
