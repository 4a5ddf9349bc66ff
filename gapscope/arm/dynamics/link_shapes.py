"""Shapes and named frames of a URDF, placed on the bodies that move them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.input_file import is_file
from gapscope.arm.known_robots import pybullet_data

SCHEMES = ("package://", "model://", "file://")
"""How a URDF may begin the path of a mesh."""


@dataclass(frozen=True)
class Frame:
    """A link of a URDF as a frame on a moving body.

    Attributes:
        name: of the link.
        joint: name of the joint that moves it, or an empty string for the base.
        position: of the link's frame in that joint's frame [m], shape (3,).
        rotation: of the same, shape (3, 3).
    """

    name: str
    joint: str
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape.

    Attributes:
        use: ``visual`` or ``collision``.
        frame: its place on the moving body; ``name`` is that of its link.
        kind: ``mesh``, ``box``, ``cylinder`` or ``sphere``.
        size: edges of a box [m], radius and length of a cylinder [m], radius of a sphere [m], scale of a mesh [1].
        mesh: file of a mesh, or ``None``.
        colour: red, green, blue and opacity, 0 to 1, or ``None``.
    """

    use: str
    frame: Frame
    kind: str
    size: tuple[float, ...]
    mesh: Path | None = None
    colour: tuple[float, ...] | None = None


def read_frames(body: RigidBody) -> dict[str, Frame]:
    """Links of the URDF by name, those that are fixed to a moving body with their place on it."""
    model = body.model
    found = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            joint = model.names[frame.parentJoint] if frame.parentJoint else ""
            place = frame.placement
            found[frame.name] = Frame(
                frame.name, joint, place.translation.copy(), place.rotation.copy()
            )
    return found


def read_shapes(body: RigidBody) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Shapes of the URDF, and a sentence for each that cannot be used; nothing of an MJCF file."""
    root = ET.parse(body.file).getroot()
    if root.tag != "robot":
        return (), ("shapes: they are read from URDF files alone",)
    frames, colours = read_frames(body), _colours(root)
    shapes, notes = [], []
    for link in root.findall("link"):
        frame = frames.get(link.get("name", ""))
        for element in (*link.findall("visual"), *link.findall("collision")):
            shape = (
                None if frame is None else _shape(element, frame, body.file, colours)
            )
            if shape is None:
                notes.append(
                    f"a {element.tag} shape of link {link.get('name')}: {_said(element)}"
                )
            else:
                shapes.append(shape)
    return tuple(shapes), tuple(dict.fromkeys(notes))


def find_mesh(name: str, urdf: Path) -> Path | None:
    """File of a mesh that a URDF names, or ``None`` if it is not found.

    A path after ``package://`` starts from the folder of the URDF or one of the three above it, with the package's
    name or without; that of ``pybullet_data`` from the installed package too.
    """
    scheme = next((s for s in SCHEMES if name.startswith(s)), "")
    rest = Path(name[len(scheme) :])
    in_package = scheme in SCHEMES[:2]
    # the package's folder may have another name than the package
    without_package = Path(*rest.parts[1:]) if len(rest.parts) > 1 else rest
    parts = (rest, without_package) if in_package else (rest,)
    folders = list(urdf.resolve().parents[: 4 if in_package else 1])
    if in_package and rest.parts[:1] == ("pybullet_data",):
        folders += filter(None, [pybullet_data()])
    for part in parts:
        for folder in folders:
            if is_file(folder / part):
                return (folder / part).resolve()
    return None


def _shape(
    element: ET.Element, frame: Frame, urdf: Path, colours: dict[str, tuple[float, ...]]
) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not len(geometry):
        return None
    form, origin = geometry[0], element.find("origin")
    xyz, rpy = (
        _numbers(None if origin is None else origin.get(key), "0 0 0")
        for key in ("xyz", "rpy")
    )
    own = Frame(
        frame.name,
        frame.joint,
        frame.position + frame.rotation @ xyz,
        frame.rotation @ pin.rpy.rpyToMatrix(rpy),
    )
    colour = _colour(element.find("material"), colours)
    if form.tag == "mesh":
        mesh = find_mesh(form.get("filename", ""), urdf)
        scale = tuple(_numbers(form.get("scale"), "1 1 1").tolist())
        return (
            None
            if mesh is None
            else Shape(element.tag, own, "mesh", scale, mesh, colour)
        )
    keys = {
        "box": ("size",),
        "cylinder": ("radius", "length"),
        "sphere": ("radius",),
    }.get(form.tag)
    if keys is None:
        return None
    size = tuple(x for key in keys for x in _numbers(form.get(key), "0").tolist())
    return Shape(element.tag, own, form.tag, size, None, colour)


def _said(element: ET.Element) -> str:
    """What cannot be used of a shape."""
    mesh = element.find("geometry/mesh")
    return (
        "it has no known geometry"
        if mesh is None
        else f"the mesh {mesh.get('filename')} is not found"
    )


def _colours(root: ET.Element) -> dict[str, tuple[float, ...]]:
    """Colours of the materials that have a name."""
    named = {m.get("name", ""): _colour(m, {}) for m in root.iter("material")}
    return {name: colour for name, colour in named.items() if name and colour}


def _colour(
    material: ET.Element | None, colours: dict[str, tuple[float, ...]]
) -> tuple[float, ...] | None:
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        return colours.get(material.get("name", ""))
    return tuple(_numbers(colour.get("rgba"), "1 1 1 1").tolist())


def _numbers(text: str | None, otherwise: str) -> np.ndarray:
    return np.array((text or otherwise).split(), dtype=float)
