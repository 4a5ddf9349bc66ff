"""Inertials of links: read, scaled, checked for what is odd, and as boxes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from gapscope.arm.beyond_any_arm import check_size
from gapscope.arm.dynamics.mjcf import NAMELESS, numbers
from gapscope.arm.errors import InputError

# Boxes in place of collision shapes that are missing: of the same mass, centre and inertia as the bodies.


THINNEST = 1e-3
"""Least edge of a box [m], for inertias whose largest moment is the sum of the others or above it."""


def box_edges(mass: float, moments: np.ndarray) -> np.ndarray:
    """Edges a_i [m] of the homogeneous box with principal moments I_i = m (a_j^2 + a_k^2) / 12, shape (3,).

    Solved for the edges: a_i^2 = 6 (I_j + I_k - I_i) / m.

    Args:
        mass: m [kg], above 0.
        moments: I about the centre of mass [kg m^2], shape (3,).
    """
    squares = 6 / mass * (moments.sum() - 2 * moments)
    return np.sqrt(np.maximum(squares, THINNEST**2))


def inertia_boxes(model: pin.Model) -> pin.GeometryModel:
    """One box for each body with mass, what is fixed to it included; the base is one if the file gives it mass."""
    shapes = pin.GeometryModel()
    for joint, inertia in enumerate(model.inertias):
        if inertia.mass <= 0:
            continue
        moments, axes = np.linalg.eigh(inertia.inertia)
        # eigenvectors may be those of a mirror; a box is the same either way
        axes[:, 2] *= np.linalg.det(axes)
        shapes.addGeometryObject(
            pin.GeometryObject(
                f"box of {model.names[joint]}",
                joint,
                pin.SE3(axes, inertia.lever),
                coal.Box(*box_edges(inertia.mass, moments)),
            )
        )
    return shapes


# The inertials of a URDF or MJCF file: non-physical ones are refused, implausible ones are used with a warning.


MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of ``<inertia>``."""
ROUNDING = 1e-15
"""Moments of inertia this far below zero are rounding of a file that was converted [kg m^2]."""
GIVE = "give mass [kg] and inertia [kg m^2], or leave <inertial> out of a link that has no mass"


class _Words(NamedTuple):
    """What a format calls mass and moments of inertia, and how they are corrected."""

    mass: str
    inertia: str
    remedy: str


URDF = _Words(
    "<mass>",
    "<inertia>",
    "correct ixx ... izz: moments about the centre of mass, in the axes of <origin>",
)
MJCF = _Words(
    "mass",
    "it",
    "correct diaginertia or fullinertia: moments about the centre of mass, in the axes of quat",
)


def inertial_faults(root: ET.Element, path: Path) -> dict[str, InputError]:
    """Errors about links of a URDF, or bodies of an MJCF file, whose inertial no body can have, by their name.

    A number is missing or none, a mass is negative, or a principal moment is.
    """
    tag = "link" if root.tag == "robot" else "body"
    faults = {}
    for link in root.iter(tag):
        try:
            _check_inertial(link, tag, path)
        except InputError as error:
            faults[link.get("name", NAMELESS)] = error
    return faults


def _check_inertial(link: ET.Element, tag: str, path: Path) -> None:
    """Check mass and moments of inertia of a link, if it has any.

    Raises:
        InputError: they cannot be; names the link.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return
    read, words = (_of_urdf, URDF) if tag == "link" else (_of_mjcf, MJCF)
    where = f"{tag} {link.get('name', NAMELESS)}, <inertial>"
    mass, inertia = read(inertial, path, where)
    if mass < 0:
        raise InputError(
            f"{words.mass} is {mass:g} kg, expected zero or above",
            "correct its value",
            file=path,
            where=where,
        )
    check_size(mass, "mass", path, where)
    check_size(inertia, "moment of inertia", path, where)
    check_size(_centre(inertial, tag, path, where), "length", path, where)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -max(1e-6 * abs(moments[2]), ROUNDING):
        raise InputError(
            f"{words.inertia} has the principal moments {listed(moments)} kg m^2, expected none below zero",
            words.remedy,
            file=path,
            where=where,
        )


def _centre(
    inertial: ET.Element, tag: str, path: Path, where: str
) -> np.ndarray | float:
    """Centre of mass in the link's frame [m], shape (3,); zero if the file does not say."""
    holder, key = (
        (inertial.find("origin"), "xyz") if tag == "link" else (inertial, "pos")
    )
    text = None if holder is None else holder.get(key)
    return 0.0 if text is None else numbers(text, 3, path, f"{where}, {key}")


def _of_urdf(inertial: ET.Element, path: Path, where: str) -> tuple[float, np.ndarray]:
    """Mass [kg] and moments of inertia [kg m^2], shape (3, 3), in the inertial's own axes."""
    mass = _number(inertial, "mass", "value", path, where)
    return mass, moments_matrix(
        [_number(inertial, "inertia", name, path, where) for name in MOMENTS]
    )


def _of_mjcf(inertial: ET.Element, path: Path, where: str) -> tuple[float, np.ndarray]:
    """The same of MJCF, which has the moments as three principal ones or as six."""
    mass = numbers(_given(inertial, "mass", path, where), 1, path, f"{where}, mass")[0]
    if (full := inertial.get("fullinertia")) is not None:
        xx, yy, zz, xy, xz, yz = numbers(full, 6, path, f"{where}, fullinertia")
        return float(mass), moments_matrix([xx, xy, xz, yy, yz, zz])
    return float(mass), np.diag(
        numbers(
            _given(inertial, "diaginertia", path, where),
            3,
            path,
            f"{where}, diaginertia",
        )
    )


def moments_matrix(moments: Iterable[float]) -> np.ndarray:
    """The matrix of ixx, ixy, ixz, iyy, iyz, izz, shape (3, 3)."""
    xx, xy, xz, yy, yz, zz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _given(inertial: ET.Element, attribute: str, path: Path, where: str) -> str:
    """An attribute that may not be absent."""
    text = inertial.get(attribute)
    if text is None:
        raise InputError(f"has no {attribute}", GIVE, file=path, where=where)
    return text


def _number(
    inertial: ET.Element, tag: str, attribute: str, path: Path, where: str
) -> float:
    """A finite number of a URDF's inertial."""
    element = inertial.find(tag)
    text = None if element is None else element.get(attribute)
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(
            f'expected <{tag} {attribute}="a number">, got {"none" if text is None else repr(text)}',
            GIVE,
            file=path,
            where=where,
        )
    return value


def listed(moments: np.ndarray) -> str:
    """Principal moments as text [kg m^2], shape (3,)."""
    return ", ".join(f"{moment:.4g}" for moment in moments)
