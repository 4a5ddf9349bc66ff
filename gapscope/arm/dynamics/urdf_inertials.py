"""Inertial parameters of the links of a URDF, read from its elements and written back into them."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import moments_matrix
from gapscope.arm.dynamics.plain_urdf import numbers


def own_parameters(link: ET.Element) -> np.ndarray:
    """The ten parameters of a link alone, without what is fixed to it, in its own frame; zero without an inertial.

    In the order of ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``; kg, kg m, kg m^2; shape (10,).
    """
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(10)
    origin, mass, moments = (
        inertial.find(tag) for tag in ("origin", "mass", "inertia")
    )
    assert mass is not None and moments is not None  # a URDF that was read has both
    xyz, rpy = (_vector(origin, key) for key in ("xyz", "rpy"))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    own = moments_matrix(float(moments.get(name, 0)) for name in names)
    turn = pin.rpy.rpyToMatrix(rpy)
    inertia = pin.Inertia(float(mass.get("value", 0)), xyz, turn @ own @ turn.T)
    return np.asarray(inertia.toDynamicParameters())


def set_parameters(link: ET.Element, parameters: np.ndarray) -> None:
    """Give a link these ten parameters, in its own frame."""
    for old in link.findall("inertial"):
        link.remove(old)
    if not np.any(parameters):
        return
    inertia = pin.Inertia.FromDynamicParameters(np.asarray(parameters, dtype=float))
    moments = inertia.inertia
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(inertia.lever), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    places = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    ET.SubElement(
        inertial,
        "inertia",
        {name: repr(float(moments[at])) for name, at in places.items()},
    )
    link.insert(0, inertial)


def possible(parameters: np.ndarray) -> bool:
    """Whether a body can have these ten parameters: mass above zero, moments not below it and within the triangle."""
    if parameters[0] <= 0:
        return False
    inertia = pin.Inertia.FromDynamicParameters(np.asarray(parameters, dtype=float))
    least, middle, largest = np.linalg.eigvalsh(inertia.inertia)
    slack = 1e-9 * largest
    return bool(least >= -slack and largest <= least + middle + slack)


def _vector(origin: ET.Element | None, key: str) -> np.ndarray:
    return np.array(
        (("" if origin is None else origin.get(key)) or "0 0 0").split(), dtype=float
    )
