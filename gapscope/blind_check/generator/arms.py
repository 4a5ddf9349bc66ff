"""The arms of the blind check: known robots, arms by Denavit-Hartenberg tables, and arms that are drawn."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.arm.known_robots import KNOWN_ROBOTS, pybullet_data
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.urdf import (
    Inertial,
    add_limit,
    cleaned,
    set_inertial,
    text_of,
)


@dataclass(frozen=True)
class Arm:
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

    home: list[float]
    half: list[float]
    armature: list[float]
    coulomb: list[float]
    viscous: list[float]
    payload: float


_SEVEN = [1.4, 0.9, 1.4, 0.9, 1.5, 1.0, 1.6]
_UR_HOME, _UR_HALF = [0, -1.2, 1.2, -1.0, -1.57, 0], [1.6, 1.0, 1.1, 1.4, 1.4, 1.6]
SHEETS = {
    "franka_panda": Sheet(
        [0, -0.2, 0, -1.5, 0, 1.6, 0],
        _SEVEN,
        [1.1, 1.3, 0.8, 0.6, 0.1, 0.1, 0.05],
        [0.9, 1.8, 0.8, 0.8, 0.2, 0.2, 0.1],
        [0.5, 1.3, 0.5, 0.5, 0.15, 0.15, 0.08],
        2.5,
    ),
    "kuka_iiwa": Sheet(
        [0, 0.4, 0, -1.2, 0, 0.9, 0],
        _SEVEN,
        [1.2, 1.5, 0.8, 0.7, 0.3, 0.1, 0.05],
        [2.0, 2.5, 1.2, 1.0, 0.6, 0.35, 0.2],
        [1.5, 1.6, 0.9, 0.8, 0.4, 0.25, 0.12],
        6.0,
    ),
    "xarm6": Sheet(
        [0, -0.6, -0.9, 0, 0.9, 0],
        [1.5, 0.7, 0.7, 1.4, 1.0, 1.6],
        [0.7, 1.0, 0.6, 0.2, 0.12, 0.05],
        [1.5, 2.2, 1.2, 0.4, 0.3, 0.12],
        [1.2, 1.6, 1.0, 0.3, 0.25, 0.1],
        3.0,
    ),
    "ur5_like": Sheet(
        _UR_HOME,
        _UR_HALF,
        [0.8, 1.6, 0.5, 0.18, 0.18, 0.08],
        [1.0, 1.8, 1.0, 0.2, 0.2, 0.15],
        [1.0, 1.4, 0.9, 0.2, 0.18, 0.12],
        4.0,
    ),
    "ur10_like": Sheet(
        _UR_HOME,
        _UR_HALF,
        [2.5, 4.0, 1.5, 0.4, 0.3, 0.12],
        [6.0, 8.0, 4.0, 0.8, 0.5, 0.3],
        [6.0, 7.0, 3.5, 1.0, 0.7, 0.3],
        8.0,
    ),
}
"""Values of the class of each robot [hollerbach2008, gaz2019]."""

_H = np.pi / 2
DH = {
    "ur5_like": (
        [0.0892, 0, 0, 0.1092, 0.0947, 0.0823],
        [0, -0.425, -0.3923, 0, 0, 0],
        [3.7, 8.39, 2.33, 1.22, 1.22, 0.35],
        [0.07, 0.13, 0.1, 0.05, 0.05, 0.04],
    ),
    "ur10_like": (
        [0.1273, 0, 0, 0.1639, 0.1157, 0.0922],
        [0, -0.612, -0.5723, 0, 0, 0],
        [7.1, 12.7, 4.27, 2.0, 2.0, 0.6],
        [0.09, 0.17, 0.14, 0.06, 0.06, 0.04],
    ),
}
"""Per robot: offsets d and lengths a [m], masses [kg], radii of gyration [m]; alpha is that of the UR family."""
ALPHA = [_H, 0, 0, _H, -_H, 0]

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
        urdf = text_of(_by_dh(*DH[name]))
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
    n = len(sheet.home)
    armature = np.array(sheet.armature) * rng.uniform(0.7, 1.4, n)
    coulomb = np.array(sheet.coulomb) * rng.uniform(0.7, 1.4, n)
    viscous = np.array(sheet.viscous) * rng.uniform(0.7, 1.4, n)
    home = np.array(sheet.home, dtype=float)
    half = np.array(sheet.half, dtype=float)
    return Arm(name, urdf, home, half, armature, coulomb, viscous, sheet.payload)


class ChainLink(NamedTuple):
    """A link of a chain and the joint that moves it.

    Origin [m] and roll-pitch-yaw [rad] of the joint in the frame of the one before, its axis, and the inertial; (3,).
    """

    xyz: np.ndarray
    rpy: np.ndarray
    axis: np.ndarray
    inertial: Inertial


def _by_dh(
    d: list[float], a: list[float], masses: list[float], radii: list[float]
) -> ET.Element:
    """A serial arm by a standard Denavit-Hartenberg table; each link is a body half way along its way."""
    links = []
    axis = np.array([0.0, 0.0, 1.0])
    xyz: np.ndarray = np.zeros(3)
    rpy: np.ndarray = np.zeros(3)
    for k, alpha in enumerate(ALPHA):
        way = np.array([a[k], 0.0, d[k]])
        rod = _rod(masses[k], 0.5 * way, way, radii[k])
        links.append(ChainLink(xyz, rpy, axis, rod))
        # the transform of the table comes after the joint, so the next link bears it
        xyz = way
        rpy = np.array([alpha, 0.0, 0.0])
    return _serial(links)


AXES = ("z", "y", "y", "x", "y", "x", "y")
"""Axes of a drawn arm: shoulder and elbow as most arms have them, then a wrist."""
LENGTHS = (0.25, 0.35, 0.32, 0.12, 0.12, 0.1, 0.08)
"""Middle of its links' lengths [m]."""
MASSES = (5.0, 6.0, 3.5, 2.0, 1.4, 1.0, 0.6)
"""Middle of its links' masses [kg]."""
HOME = (0.0, 0.4, 0.5, 0.0, 0.5, 0.0, 0.4)
"""Middle posture of its motions [rad]."""
HALF = (1.5, 0.8, 0.9, 1.4, 1.2, 1.5, 1.2)
"""Half range of its motions [rad]."""


def _drawn(rng: np.random.Generator, n: int) -> Arm:
    """A new arm: rods whose mass falls outwards, with a data sheet after the mass that each joint carries."""
    lengths = np.array(LENGTHS)[:n] * rng.uniform(0.8, 1.25, n)
    masses = np.array(MASSES)[:n] * rng.uniform(0.7, 1.5, n) * rng.uniform(0.6, 2.0)
    links = []
    xyz = np.array([0.0, 0.0, 0.15])
    for j in range(n):
        # the column stands, the rest of the arm reaches forward
        direction = [0.0, 0.0, 1.0] if j < 2 else [1.0, 0.0, 0.0]
        way = lengths[j] * np.array(direction)
        com = 0.5 * way + rng.uniform(-0.03, 0.03, 3)
        rod = _rod(masses[j], com, way, 0.25 * lengths[j] + 0.02)
        axis = np.array([float(name == AXES[j]) for name in "xyz"])
        links.append(ChainLink(xyz, np.zeros(3), axis, rod))
        xyz = way
    outer = np.array([masses[j:].sum() * lengths[j:].sum() for j in range(n)])
    inertia = 0.05 * outer * lengths + 0.01
    friction = list(0.1 * outer + 0.03)
    sheet = Sheet(
        home=list(HOME[:n]),
        half=list(HALF[:n]),
        armature=list(4.0 * inertia),
        coulomb=friction,
        viscous=friction,
        payload=0.35 * float(masses[-3:].sum()),
    )
    return _with_sheet("drawn", text_of(_serial(links)), sheet, rng)


def _rod(mass: float, com: np.ndarray, way: np.ndarray, radius: float) -> Inertial:
    """A thick rod along ``way``: m (l^2 - way way^T) / 12 plus m r^2 / 2 about every axis."""
    thin = mass * (way @ way * np.eye(3) - np.outer(way, way)) / 12.0
    thick = 0.5 * mass * radius**2 * np.eye(3)
    return Inertial(mass, np.asarray(com), thin + thick)


def _serial(links: list[ChainLink]) -> ET.Element:
    """URDF of a chain."""
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="base")
    parent = "base"
    for k, link in enumerate(links, 1):
        child = f"link_{k}"
        set_inertial(ET.SubElement(root, "link", name=child), link.inertial)
        joint = ET.SubElement(root, "joint", name=f"joint_{k}", type="revolute")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "origin", xyz=_text(link.xyz), rpy=_text(link.rpy))
        ET.SubElement(joint, "axis", xyz=_text(link.axis))
        add_limit(joint)
        parent = child
    return root


def _text(values: np.ndarray) -> str:
    """Numbers as an attribute."""
    return " ".join(f"{float(x):.9g}" for x in values)
