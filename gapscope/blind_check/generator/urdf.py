"""URDF text of the generator's arms: cleaned, read and changed link by link."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

RADIUS = 0.08
"""Radius of gyration given to a link with a non-physical inertia [m]."""


class Inertial(NamedTuple):
    """Mass [kg], centre of mass [m] (3,) and inertia about it [kg m^2] (3, 3), in the frame of the link."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray


def cleaned(text: str, joints: Sequence[str] | None) -> ET.Element:
    """Root of a URDF without looks and friction; joints that are not the arm's are fixed, links sound.

    Args:
        text: URDF.
        joints: joints of the arm; ``None``: every movable one.
    """
    root = ET.fromstring(text)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    for link in root.findall("link"):
        _keep_only(link, ("inertial",))
        if link.find("inertial") is not None:
            set_inertial(link, _sound(inertial_of(link)))
    for joint in root.findall("joint"):
        locked = joints is not None and joint.get("name") not in joints
        if joint.get("type") == "fixed" or locked:
            joint.set("type", "fixed")
        elif joint.get("type") == "continuous":
            joint.set("type", "revolute")
        _keep_only(joint, ("parent", "child", "origin", "axis"))
        if joint.get("type") == "revolute":
            add_limit(joint)
    root.set("name", "arm")
    return root


def _keep_only(parent: ET.Element, tags: Sequence[str]) -> None:
    """Remove all children with other tags."""
    for element in list(parent):
        if element.tag not in tags:
            parent.remove(element)


def add_limit(joint: ET.Element) -> None:
    """Give a joint limits that no motion of the blind check meets."""
    ET.SubElement(
        joint,
        "limit",
        lower="-6.28318",
        upper="6.28318",
        effort="1000",
        velocity="10",
    )


def text_of(root: ET.Element) -> str:
    """URDF text of a root element."""
    return ET.tostring(root, encoding="unicode")


def copied(root: ET.Element) -> ET.Element:
    """A copy that can be changed on its own."""
    return ET.fromstring(text_of(root))


def movable(root: ET.Element) -> list[ET.Element]:
    """The joints that move, in the order of the file."""
    return [joint for joint in root.findall("joint") if joint.get("type") == "revolute"]


def moved_links(root: ET.Element) -> list[ET.Element]:
    """The links that the joints move, in the order of the joints."""
    links = {link.get("name"): link for link in root.findall("link")}
    children = [joint.find("child") for joint in movable(root)]
    return [links[child.get("link")] for child in children if child is not None]


def inertial_of(link: ET.Element) -> Inertial:
    """The inertial of a link, turned into the frame of the link."""
    element = link.find("inertial")
    assert element is not None
    origin, inertia = element.find("origin"), element.find("inertia")
    assert inertia is not None
    com: np.ndarray = np.zeros(3)
    turn: np.ndarray = np.eye(3)
    if origin is not None:
        com = _numbers(origin.get("xyz", "0 0 0"))
        rpy = _numbers(origin.get("rpy", "0 0 0"))
        turn = Rotation.from_euler("xyz", rpy).as_matrix()
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (float(inertia.attrib[name]) for name in names)
    own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = float(element.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    return Inertial(mass, com, turn @ own @ turn.T)


def _numbers(text: str) -> np.ndarray:
    """Numbers of an attribute."""
    return np.array([float(x) for x in text.split()])


def set_inertial(link: ET.Element, inertial: Inertial) -> None:
    """Give a link another inertial."""
    old = link.find("inertial")
    if old is not None:
        link.remove(old)
    new = ET.SubElement(link, "inertial")
    com = " ".join(repr(float(x)) for x in inertial.com)
    ET.SubElement(new, "origin", rpy="0 0 0", xyz=com)
    ET.SubElement(new, "mass", value=repr(float(inertial.mass)))
    places = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    moments = {key: repr(float(inertial.inertia[at])) for key, at in places.items()}
    ET.SubElement(new, "inertia", moments)


def added(link: Inertial, load: Inertial) -> Inertial:
    """Two rigid bodies in one frame as one: masses add, inertias about the common centre (parallel axes)."""
    mass = link.mass + load.mass
    com = (link.mass * link.com + load.mass * load.com) / mass
    inertia = sum(b.inertia + _steiner(b.mass, b.com - com) for b in (link, load))
    return Inertial(mass, com, np.asarray(inertia))


def perturb_inertials(root: ET.Element, width: float, rng: np.random.Generator) -> None:
    """Put every inertial a little off, by up to ``width`` [1] of its mass and of the centre's distance.

    The inertia takes the mass's factor; the centre moves in any direction.
    """
    for link in moved_links(root):
        body = inertial_of(link)
        factor = 1.0 + width * rng.uniform(-1.0, 1.0)
        way = rng.standard_normal(3)
        distance = max(float(np.linalg.norm(body.com)), 0.02)
        shift = width * rng.uniform() * distance * way / np.linalg.norm(way)
        set_inertial(
            link, Inertial(body.mass * factor, body.com + shift, body.inertia * factor)
        )


def shifted(root: ET.Element) -> None:
    """Give each moved link the inertial of its neighbour before it, the first that of the last."""
    links = moved_links(root)
    bodies = [inertial_of(link) for link in links]
    for link, body in zip(links, bodies[-1:] + bodies[:-1], strict=True):
        set_inertial(link, body)


def _steiner(mass: float, way: np.ndarray) -> np.ndarray:
    """Inertia of a point mass at ``way`` [m] about the origin: m (r^T r E - r r^T) [kg m^2]."""
    return mass * (way @ way * np.eye(3) - np.outer(way, way))


def _sound(body: Inertial) -> Inertial:
    """The inertial, with an inertia that a body of this mass can have (positive, triangle inequality)."""
    mass = max(body.mass, 1e-3)
    least, middle, largest = np.linalg.eigvalsh(body.inertia)
    triangle = largest <= least + middle
    compact = largest < mass * 0.3**2
    if least > 1e-9 and triangle and compact:
        return Inertial(mass, body.com, body.inertia)
    return Inertial(mass, body.com, mass * RADIUS**2 * np.eye(3))
