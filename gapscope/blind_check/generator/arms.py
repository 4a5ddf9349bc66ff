"""The arms of the blind check: known robots, arms by Denavit-Hartenberg tables, and arms that are drawn."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm
from gapscope.blind_check.generator.urdf import Inertial, cleaned, set_inertial, text_of


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
        return _drawn(rng, 3 if name == "small" else int(rng.integers(3, 8)))
    if name in DH:
        urdf = text_of(_by_dh(*DH[name]))
    else:
        path = load_nominal_arm(name).urdf
        urdf = text_of(
            cleaned(path.read_text(encoding="utf-8"), KNOWN_ROBOTS[name].joints)
        )
    return _with_sheet(name, urdf, SHEETS[name], rng)


def _with_sheet(name: str, urdf: str, sheet: Sheet, rng: np.random.Generator) -> Arm:
    n = len(sheet.home)
    armature, coulomb, viscous = (
        np.array(values) * rng.uniform(0.7, 1.4, n)
        for values in (sheet.armature, sheet.coulomb, sheet.viscous)
    )
    home, half = np.array(sheet.home, dtype=float), np.array(sheet.half, dtype=float)
    return Arm(name, urdf, home, half, armature, coulomb, viscous, sheet.payload)


def _by_dh(
    d: list[float], a: list[float], masses: list[float], radii: list[float]
) -> ET.Element:
    """A serial arm by a standard Denavit-Hartenberg table; each link is a body half way along its way."""
    links = []
    xyz: np.ndarray = np.zeros(3)
    rpy: np.ndarray = np.zeros(3)
    for offset, length, alpha, mass, radius in zip(
        d, a, ALPHA, masses, radii, strict=True
    ):
        way = np.array([length, 0.0, offset])
        links.append(
            (xyz, rpy, np.array([0.0, 0.0, 1.0]), _rod(mass, 0.5 * way, way, radius))
        )
        xyz, rpy = way, np.array([alpha, 0.0, 0.0])
    return _serial(links)


def _drawn(rng: np.random.Generator, n: int) -> Arm:
    """A new arm: shoulder and elbow as most arms have them, then a wrist; rods whose mass falls outwards."""
    axes = np.array(
        [[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]],
        dtype=float,
    )[:n]
    lengths = np.array([0.25, 0.35, 0.32, 0.12, 0.12, 0.1, 0.08])[:n] * rng.uniform(
        0.8, 1.25, n
    )
    masses = (
        np.array([5.0, 6.0, 3.5, 2.0, 1.4, 1.0, 0.6])[:n]
        * rng.uniform(0.7, 1.5, n)
        * rng.uniform(0.6, 2.0)
    )
    links, xyz = [], np.array([0.0, 0.0, 0.15])
    for j in range(n):
        way = lengths[j] * (
            np.array([0.0, 0.0, 1.0]) if j < 2 else np.array([1.0, 0.0, 0.0])
        )
        com = 0.5 * way + rng.uniform(-0.03, 0.03, 3)
        links.append(
            (
                xyz,
                np.zeros(3),
                axes[j],
                _rod(masses[j], com, way, 0.25 * lengths[j] + 0.02),
            )
        )
        xyz = way
    outer = np.array([masses[j:].sum() * lengths[j:].sum() for j in range(n)])
    arm = 0.05 * outer * lengths + 0.01
    sheet = Sheet(
        list(np.array([0, 0.4, 0.5, 0, 0.5, 0, 0.4])[:n]),
        list(np.array([1.5, 0.8, 0.9, 1.4, 1.2, 1.5, 1.2])[:n]),
        list(4.0 * arm),
        list(0.1 * outer + 0.03),
        list(0.1 * outer + 0.03),
        0.35 * float(masses[-3:].sum()),
    )
    return _with_sheet("drawn", text_of(_serial(links)), sheet, rng)


def _rod(mass: float, com: np.ndarray, way: np.ndarray, radius: float) -> Inertial:
    """A thick rod along ``way``: m (l^2 - way way^T) / 12 plus m r^2 / 2 about every axis."""
    inertia = mass * (
        way @ way * np.eye(3) - np.outer(way, way)
    ) / 12.0 + 0.5 * mass * radius**2 * np.eye(3)
    return Inertial(mass, np.asarray(com), inertia)


def _serial(
    links: list[tuple[np.ndarray, np.ndarray, np.ndarray, Inertial]],
) -> ET.Element:
    """URDF of a chain: per link the joint's origin, its roll-pitch-yaw, its axis, and the inertial."""
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="base")
    line = lambda values: " ".join(f"{float(x):.9g}" for x in values)  # noqa: E731
    parent = "base"
    for k, (xyz, rpy, axis, body) in enumerate(links, 1):
        set_inertial(ET.SubElement(root, "link", name=f"link_{k}"), body)
        joint = ET.SubElement(root, "joint", name=f"joint_{k}", type="revolute")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=f"link_{k}")
        ET.SubElement(joint, "origin", xyz=line(xyz), rpy=line(rpy))
        ET.SubElement(joint, "axis", xyz=line(axis))
        ET.SubElement(
            joint,
            "limit",
            lower="-6.28318",
            upper="6.28318",
            effort="1000",
            velocity="10",
        )
        parent = f"link_{k}"
    return root
