"""The nominal arm with the inertials of its URDF moved to other links."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm


def shifted_arm(arm: NominalArm, links: int, moved_only: bool = False) -> NominalArm:
    """The arm with each ``<inertial>`` moved ``links`` further among the links that have one, in file order.

    With ``moved_only`` among those of them that a joint moves. The new URDF lies in a temporary folder that lasts as
    long as the process, one for each text. An MJCF file is left as it is.
    """
    text = _shifted_text(arm, links, moved_only)
    if text is None:
        return arm
    return replace(arm, urdf=Path(_folder(text, arm.urdf.name).name) / arm.urdf.name)


def shifted_body(
    arm: NominalArm, links: int, moved_only: bool = False
) -> RigidBody | None:
    """Dynamics of ``shifted_arm``, for a trial that leaves no file behind; ``None`` if nothing would be moved.

    Raises:
        InputError: with its inertials moved the arm is none that can be.
    """
    text = _shifted_text(arm, links, moved_only)
    if text is None:
        return None
    with TemporaryDirectory(prefix="gapscope-") as folder:
        path = Path(folder) / arm.urdf.name
        path.write_text(text, encoding="utf-8")
        return RigidBody(replace(arm, urdf=path))


def _shifted_text(arm: NominalArm, links: int, moved_only: bool) -> str | None:
    """The changed URDF; ``None`` if nothing is moved, or the file is no URDF."""
    if links == 0 or ET.parse(arm.urdf).getroot().tag != "robot":
        return None
    return shifted_text(arm.urdf.read_text(encoding="utf-8"), links, moved_only)


def shifted_text(text: str, by: int, moved_only: bool = False) -> str:
    """URDF text with the ``<inertial>`` of each link that has one moved ``by`` such links further, in file order."""
    root = ET.fromstring(text)
    links = _links(root, moved_only)
    inertials = [link.find("inertial") for link in links]
    givers = np.roll(np.arange(len(links)), by)
    for link, own, giver in zip(links, inertials, givers, strict=True):
        given = inertials[int(giver)]
        assert own is not None and given is not None
        link.remove(own)
        link.append(given)
    return ET.tostring(root, encoding="unicode")


def _links(root: ET.Element, moved_only: bool) -> list[ET.Element]:
    """Links whose inertials are exchanged, in file order."""
    moved = {
        child.get("link")
        for joint in root.iter("joint")
        if joint.get("type") in ("revolute", "continuous", "prismatic")
        for child in joint.iter("child")
    }
    return [
        link
        for link in root.iter("link")
        if link.find("inertial") is not None
        and (not moved_only or link.get("name") in moved)
    ]


@cache
def _folder(text: str, name: str) -> TemporaryDirectory[str]:
    """Temporary folder with a URDF; kept by its text, so that a thousand cases of one arm share it."""
    folder: TemporaryDirectory[str] = TemporaryDirectory(prefix="gapscope-")
    (Path(folder.name) / name).write_text(text, encoding="utf-8")
    return folder
