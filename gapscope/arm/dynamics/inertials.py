"""The inertials of a URDF or MJCF file: non-physical ones are refused, implausible ones are used with a warning."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.mjcf import NAMELESS, numbers
from gapscope.arm.errors import InputError

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of ``<inertia>``."""
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


def check_inertials(root: ET.Element, path: Path) -> None:
    """Check mass and moments of inertia of each link of a URDF, or body of an MJCF file, that has any.

    Raises:
        InputError: a number is missing or none, a mass is negative, or a principal moment is; names the link.
    """
    tag, read, words = (
        ("link", _of_urdf, URDF) if root.tag == "robot" else ("body", _of_mjcf, MJCF)
    )
    for link in root.iter(tag):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        where = f"{tag} {link.get('name', NAMELESS)}, <inertial>"
        mass, inertia = read(inertial, path, where)
        if mass < 0:
            raise InputError(
                f"{words.mass} is {mass:g} kg, expected zero or above",
                "correct its value",
                file=path,
                where=where,
            )
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] < -1e-6 * abs(moments[2]):
            raise InputError(
                f"{words.inertia} has the principal moments {listed(moments)} kg m^2, expected none below zero",
                words.remedy,
                file=path,
                where=where,
            )


def _of_urdf(inertial: ET.Element, path: Path, where: str) -> tuple[float, np.ndarray]:
    """Mass [kg] and moments of inertia [kg m^2], shape (3, 3), in the inertial's own axes."""
    mass = _number(inertial, "mass", "value", path, where)
    return mass, _matrix(
        [_number(inertial, "inertia", name, path, where) for name in MOMENTS]
    )


def _of_mjcf(inertial: ET.Element, path: Path, where: str) -> tuple[float, np.ndarray]:
    """The same of MJCF, which has the moments as three principal ones or as six."""
    mass = numbers(_given(inertial, "mass", path, where), 1, path, f"{where}, mass")[0]
    if (full := inertial.get("fullinertia")) is not None:
        xx, yy, zz, xy, xz, yz = numbers(full, 6, path, f"{where}, fullinertia")
        return float(mass), _matrix([xx, xy, xz, yy, yz, zz])
    return float(mass), np.diag(
        numbers(
            _given(inertial, "diaginertia", path, where),
            3,
            path,
            f"{where}, diaginertia",
        )
    )


def _matrix(moments: list[float]) -> np.ndarray:
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
