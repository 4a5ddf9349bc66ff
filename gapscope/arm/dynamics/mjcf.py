"""Content of an MJCF file beside bodies and joints, which pinocchio reads: gravity, and what is ignored.

Without MuJoCo; attributes that a default class gives count as an element's own.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError

Attributes = dict[str, str]
UNREAD = {
    "tendon": "<tendon>",
    "compiler[@settotalmass]": "<compiler settotalmass>",
}
"""What pinocchio passes over, by its path in the file."""
UNFOLDED = ("include", "replicate", "attach", "frame//body", "frame//joint")
"""Elements that contain or change bodies, and are not expanded here."""
UNWEIGHED = ("mesh", "plane", "hfield", "sdf")
"""Shapes whose mass is not known here."""
NAMELESS = "without_a_name"


def joint_attributes(root: ET.Element) -> dict[str, Attributes]:
    """Attributes of the joints that have a name."""
    classes, found = default_classes(root), {}

    def visit(element: ET.Element, inherited: str) -> None:
        inherited = element.get("childclass", inherited)
        for child in element:
            if child.tag == "joint" and (name := child.get("name")):
                found[name] = {
                    **classes.get(child.get("class", inherited), {}).get("joint", {}),
                    **child.attrib,
                }
            visit(child, inherited)

    for world in root.findall("worldbody"):
        visit(world, "main")
    return found


def default_classes(root: ET.Element) -> dict[str, dict[str, Attributes]]:
    """What each default class gives to an element, by the class and the element's tag."""
    found: dict[str, dict[str, Attributes]] = {}

    def visit(default: ET.Element, above: dict[str, Attributes]) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for child in default:
            own.setdefault(child.tag, {}).update(child.attrib)
        found[default.get("class", "main")] = own
        for child in default.findall("default"):
            visit(child, own)

    for default in root.findall("default"):
        visit(default, {})
    return found


def numbers(text: str, count: int | None, path: Path, where: str) -> np.ndarray:
    """The finite numbers of an attribute, shape (count,).

    Raises:
        InputError: not as many, or none.
    """
    try:
        values = np.array(text.split(), dtype=float)
    except ValueError:
        values = np.array([np.nan])
    if not (values.size and np.isfinite(values).all() and count in (None, len(values))):
        wanted = (
            "numbers"
            if count is None
            else "a number"
            if count == 1
            else f"{count} numbers"
        )
        raise InputError(
            f"expected {wanted}, got {text!r}",
            "correct the attribute",
            file=path,
            where=where,
        )
    return values


def gravity(root: ET.Element, path: Path) -> np.ndarray | None:
    """Gravity of ``<option>`` in the world's frame [m/s^2], shape (3,); ``None`` if the file does not say.

    Raises:
        InputError: it is not three numbers.
    """
    if root.find("option/flag[@gravity='disable']") is not None:
        return np.zeros(3)
    given = root.findall("option[@gravity]")
    return (
        numbers(given[-1].get("gravity", ""), 3, path, "<option gravity>")
        if given
        else None
    )


def check_mjcf(root: ET.Element, path: Path) -> None:
    """Check that pinocchio reads all bodies of the file, with their inertia.

    Raises:
        InputError: bodies are in other files or generated, or a moving body has its mass from a mesh.
    """
    for element in UNFOLDED:
        if root.find(f".//{element}") is not None:
            raise InputError(
                f"<{element.split('//')[0]}> is not read",
                "expand it in the file",
                file=path,
            )
    for body, geoms in _without_inertial(root):
        if meshes := [
            geom for geom in geoms if geom.get("mesh") or geom.get("type") in UNWEIGHED
        ]:
            what = meshes[0].get("mesh") or meshes[0].get("type")
            raise InputError(
                f"has no <inertial>, and its mass cannot be taken from the shape {what}",
                'give it one; MuJoCo\'s mj_saveLastXML writes it after <compiler saveinertial="true"/>',
                file=path,
                where=f"body {body.get('name', NAMELESS)}",
            )


def _without_inertial(root: ET.Element) -> list[tuple[ET.Element, list[Attributes]]]:
    """Moving bodies that are weighed by their shapes, and these."""
    by_shape = root.find("compiler[@inertiafromgeom='true']") is not None
    classes, found = default_classes(root), []

    def visit(body: ET.Element, inherited: str, moves: bool) -> None:
        inherited = body.get("childclass", inherited)
        moves = moves or body.find("joint") is not None
        geoms = [
            {
                **classes.get(geom.get("class", inherited), {}).get("geom", {}),
                **geom.attrib,
            }
            for geom in body.findall("geom")
        ]
        if moves and geoms and (by_shape or body.find("inertial") is None):
            found.append((body, geoms))
        for child in body.findall("body"):
            visit(child, inherited, moves)

    for body in root.findall("worldbody/body"):
        visit(body, "main", False)
    return found


def name_bodies(root: ET.Element) -> None:
    """Give a name to the bodies that have none: pinocchio would pass over them."""
    for number, body in enumerate(root.iter("body"), 1):
        if not body.get("name"):
            body.set("name", f"{NAMELESS}_{number}")


def check_references(root: ET.Element, path: Path, joints: Sequence[str]) -> None:
    """Check that the positions of these joints count from the pose that the file draws.

    Raises:
        InputError: the ``ref`` of a joint is not zero.
    """
    attributes = joint_attributes(root)
    for name in joints:
        ref = attributes.get(name, {}).get("ref", "0")
        if numbers(ref, 1, path, f"joint {name}, ref").any():
            raise InputError(
                f"ref is {ref}, expected 0: positions count from the pose in which the file draws the arm",
                "leave ref out and turn the body by it, or move the recorded positions",
                file=path,
                where=f"joint {name}",
            )


def left_out(root: ET.Element, path: Path, joints: Sequence[str]) -> tuple[str, ...]:
    """What acts on an arm by its file and is not simulated, a sentence each."""
    notes = [
        f"{path}: {what} is not read"
        for place, what in UNREAD.items()
        if root.find(place) is not None
    ]
    notes += _unread_equality(root, path)
    notes += [
        f"{path}: body {body.get('name', NAMELESS)} has no <inertial> and is weighed by its shapes, but for what "
        "default classes say of their mass; give it one"
        for body, _ in _without_inertial(root)
    ]
    for body in root.iter("body"):
        if numbers(
            body.get("gravcomp", "0"), 1, path, f"body {body.get('name')}, gravcomp"
        ).any():
            notes.append(
                f"{path}: gravcomp of body {body.get('name', NAMELESS)} is not read: its weight is not held up"
            )
    attributes = joint_attributes(root)
    for name in joints:
        own = attributes.get(name, {})
        if numbers(
            own.get("stiffness", "0"), None, path, f"joint {name}, stiffness"
        ).any():
            notes.append(
                f"{path}: the spring of joint {name} (stiffness {own['stiffness']}, springref "
                f"{own.get('springref', '0')}) is not read; give it as the effect parallel_spring"
            )
    return tuple(notes)


def _unread_equality(root: ET.Element, path: Path) -> list[str]:
    """Constraints other than joints that follow another one in proportion."""
    notes = []
    for element in root.findall("equality/*"):
        text = element.get("polycoef") or "0 1 0 0 0"
        higher = numbers(text, None, path, f"<equality><{element.tag}>, polycoef")[2:]
        straight = not higher.any()
        follows = element.tag == "joint" and element.get("joint2") and straight
        if not follows:
            between = ", ".join(
                element.get(key, "")
                for key in ("joint1", "joint2", "body1", "body2")
                if element.get(key)
            )
            notes.append(
                f"{path}: <equality><{element.tag}> of {between or 'unnamed parts'} is not read: what it holds "
                "together moves freely, or is locked if it is none of the arm's joints"
            )
    return notes
