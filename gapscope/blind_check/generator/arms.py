"""Arms of the generator: how they are drawn, and written as URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.description import MOMENTS, moments_matrix
from gapscope.arm.dynamics.inertials import inertial_element
from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm, pybullet_data

# URDF text of the generator's arms: cleaned, read and changed link by link.


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
    com = np.zeros(3)
    turn = np.eye(3)
    if origin is not None:
        com = _numbers(origin.get("xyz", "0 0 0"))
        rpy = _numbers(origin.get("rpy", "0 0 0"))
        turn = Rotation.from_euler("xyz", rpy).as_matrix()
    own = moments_matrix(float(inertia.attrib[name]) for name in MOMENTS)
    mass = float(element.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    return Inertial(mass, com, turn @ own @ turn.T)


def _numbers(text: str) -> np.ndarray:
    """Numbers of an attribute."""
    return np.array([float(x) for x in text.split()])


def set_inertial(link: ET.Element, inertial: Inertial) -> None:
    """Give a link another inertial."""
    for old in link.findall("inertial"):
        link.remove(old)
    link.append(inertial_element(*inertial))


def added(link: Inertial, load: Inertial) -> Inertial:
    """Two rigid bodies in one frame as one: masses add, inertias about the common centre (parallel axes)."""
    mass = link.mass + load.mass
    com = (link.mass * link.com + load.mass * load.com) / mass
    inertia = sum(b.inertia + _steiner(b.mass, b.com - com) for b in (link, load))
    return Inertial(mass, com, inertia)


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


# The arms of the blind check: known robots, arms by Denavit-Hartenberg tables, and arms that are drawn.


class Arm(NamedTuple):
    """An arm with n joints and its data sheet; joint-side SI units.

    Attributes:
        name: kind of arm.
        urdf: URDF text.
        home, half: middle posture and half range of its motions [rad], (n,).
        armature, coulomb, viscous: data sheet [kg m^2, N m, N m s/rad], (n,).
        payload: largest load [kg].
    """

    name: str
    urdf: str
    home: np.ndarray
    half: np.ndarray
    armature: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    payload: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.home)

    @property
    def root(self) -> ET.Element:
        """A fresh root element of the URDF."""
        return ET.fromstring(self.urdf)


class Sheet(NamedTuple):
    """Middle of a known robot's values; the data sheet of a case is drawn around it."""

    home: ArrayLike
    half: ArrayLike
    armature: ArrayLike
    coulomb: ArrayLike
    viscous: ArrayLike
    payload: float


_DATA = yaml.safe_load(
    Path(__file__).with_name("arms.yaml").read_text(encoding="utf-8")
)
SHEETS = {name: Sheet(**sheet) for name, sheet in _DATA["sheets"].items()}
"""Values of the class of each robot [hollerbach2008, gaz2019]."""
DH = {name: tuple(table.values()) for name, table in _DATA["dh"].items()}
"""Per robot: offsets d and lengths a [m], masses [kg], radii of gyration [m]; alpha is that of the UR family."""
ALPHA = [np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0]

USUAL = (*SHEETS, "drawn")
"""Names of the arms of a blind check; ``drawn`` is a new arm with three to seven joints each time."""
ROBOTS = (*USUAL, "small")
"""Names of all arms; ``small`` is a drawn one with three joints."""


def draw_arm(name: str, rng: np.random.Generator) -> Arm:
    """An arm of this name, with a data sheet of its own.

    Args:
        name: one of ``ROBOTS``.
        rng: source of the data sheet, and of the geometry of a drawn arm.
    """
    if name in ("drawn", "small"):
        n = 3 if name == "small" else int(rng.integers(3, 8))
        return _drawn(rng, n)
    if name in DH:
        urdf = text_of(_serial(_by_dh(DH[name])))
    else:
        # the published figures rest on the model that comes with the engine
        folder = pybullet_data()
        file = None if folder is None else folder / "franka_panda" / "panda.urdf"
        if name != "franka_panda" or file is None:
            file = load_nominal_arm(name).urdf
        text = file.read_text(encoding="utf-8")
        urdf = text_of(cleaned(text, KNOWN_ROBOTS[name].joints))
    return _with_sheet(name, urdf, SHEETS[name], rng)


def _with_sheet(name: str, urdf: str, sheet: Sheet, rng: np.random.Generator) -> Arm:
    home, half, *drives = (np.array(own, dtype=float) for own in sheet[:-1])
    armature, coulomb, viscous = (
        own * rng.uniform(0.7, 1.4, len(home)) for own in drives
    )
    return Arm(name, urdf, home, half, armature, coulomb, viscous, sheet.payload)


ChainLink = tuple[np.ndarray, np.ndarray, np.ndarray, Inertial]
"""A link and the joint that moves it: origin [m] and roll-pitch-yaw [rad] of the joint in the frame of the one before,
its axis, and the inertial; (3,)."""


def _by_dh(table: tuple[list[float], ...]) -> list[ChainLink]:
    """A serial arm by a standard Denavit-Hartenberg table; each link is a body half way along its way."""
    links = []
    axis = np.array([0.0, 0.0, 1.0])
    xyz: np.ndarray = np.zeros(3)
    rpy: np.ndarray = np.zeros(3)
    for alpha, d, a, mass, radius in zip(ALPHA, *table, strict=True):
        way = np.array([a, 0.0, d])
        links.append((xyz, rpy, axis, _rod(mass, 0.5 * way, way, radius)))
        # the transform of the table comes after the joint, so the next link bears it
        xyz, rpy = way, np.array([alpha, 0, 0], dtype=float)
    return links


_LINKS = _DATA["drawn"]
"""Middle of a drawn arm's links."""


def _drawn(rng: np.random.Generator, n: int) -> Arm:
    """A new arm: rods whose mass falls outwards, with a data sheet after the mass that each joint carries."""
    lengths = np.array(_LINKS["length"])[:n] * rng.uniform(0.8, 1.25, n)
    masses = (
        np.array(_LINKS["mass"])[:n] * rng.uniform(0.7, 1.5, n) * rng.uniform(0.6, 2.0)
    )
    links = []
    xyz = np.array([0.0, 0.0, 0.15])
    for j in range(n):
        # the column stands, the rest of the arm reaches forward
        direction = [0.0, 0.0, 1.0] if j < 2 else [1.0, 0.0, 0.0]
        way = lengths[j] * np.array(direction)
        com = 0.5 * way + rng.uniform(-0.03, 0.03, 3)
        rod = _rod(masses[j], com, way, 0.25 * lengths[j] + 0.02)
        axis = np.array([float(name == _LINKS["axis"][j]) for name in "xyz"])
        links.append((xyz, np.zeros(3), axis, rod))
        xyz = way
    outer = np.array([masses[j:].sum() * lengths[j:].sum() for j in range(n)])
    inertia = 0.05 * outer * lengths + 0.01
    friction = 0.1 * outer + 0.03
    sheet = Sheet(
        home=_LINKS["home"][:n],
        half=_LINKS["half"][:n],
        armature=4.0 * inertia,
        coulomb=friction,
        viscous=friction,
        payload=0.35 * float(masses[-3:].sum()),
    )
    return _with_sheet("drawn", text_of(_serial(links)), sheet, rng)


def _rod(mass: float, com: np.ndarray, way: np.ndarray, radius: float) -> Inertial:
    """A thick rod along ``way``: m (l^2 - way way^T) / 12 plus m r^2 / 2 about every axis."""
    thin = _steiner(mass, way) / 12.0
    thick = 0.5 * mass * radius**2 * np.eye(3)
    return Inertial(mass, com, thin + thick)


def _serial(links: list[ChainLink]) -> ET.Element:
    """URDF of a chain."""
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="base")
    parent = "base"
    for k, (xyz, rpy, axis, inertial) in enumerate(links, 1):
        child = f"link_{k}"
        set_inertial(ET.SubElement(root, "link", name=child), inertial)
        joint = ET.SubElement(root, "joint", name=f"joint_{k}", type="revolute")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
        ET.SubElement(joint, "axis", xyz=_text(axis))
        add_limit(joint)
        parent = child
    return root


def _text(values: np.ndarray) -> str:
    """Numbers as an attribute."""
    return " ".join(f"{float(x):.9g}" for x in values)
