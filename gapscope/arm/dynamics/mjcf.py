"""MJCF files: read as a chain of bodies with actuators, and written plain."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError

# Content of an MJCF file beside bodies and joints, which pinocchio reads: gravity, and what is ignored.
#
# Without MuJoCo; attributes that a default class gives count as an element's own.


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


# Actuators of an MJCF file: what they allow at the joints, and the gains of those that hold a position.


DRIVES = ("general", "motor")
"""Actuators of which a limit of the control is one of the torque."""


def torque_limits(root: ET.Element, path: Path) -> dict[str, float]:
    """Torque limit of each joint that has one [N m]: the least that the joint and its actuators allow, to either side.

    A joint's ``actuatorfrcrange``, an actuator's ``forcerange``, and of motors ``ctrlrange``, both times its gear.

    Raises:
        InputError: a range is not two numbers.
    """
    limits = {
        name: [_range(values, "actuatorfrc", path, f"joint {name}")]
        for name, values in joint_attributes(root).items()
    }
    classes = default_classes(root)
    for element in root.findall("actuator/*"):
        joint = element.get("joint", "")
        of_class = classes.get(element.get("class", "main"), {})
        values = {**of_class.get(element.tag, {}), **element.attrib}
        limits.setdefault(joint, []).extend(
            _actuator_limits(element.tag, values, path, joint)
        )
    return {joint: min(found) for joint, found in limits.items() if min(found) < np.inf}


def _actuator_limits(
    tag: str, values: Attributes, path: Path, joint: str
) -> list[float]:
    """What an actuator allows at its joint to either side [N m]."""
    place = f"actuator of joint {joint}"
    gear = _first(values, "gear", path, place)
    limits = [gear * _range(values, "force", path, place)]
    # only of a plain motor the control is a torque
    if tag in DRIVES and values.get("biastype", "none") == "none":
        gain = _first(values, "gainprm", path, place)
        limits.append(gear * gain * _range(values, "ctrl", path, place))
    return limits


def position_gains(
    root: ET.Element, path: Path, joints: Sequence[str]
) -> tuple[str, ...]:
    """A note with the gains of position actuators as the ``controller:`` of a case, if the arm's joints have any.

    A ``position`` actuator commands gear kp (u - gear q) - gear^2 kv dq: kp and kd about the joint are gear^2 times its
    own; a ``general`` one whose ``biastype`` is affine has kp and kd in ``biasprm`` [b0, -kp, -kd].
    """
    gains = {}
    classes = default_classes(root)
    for element in root.findall("actuator/*"):
        of_class = classes.get(element.get("class", "main"), {}).get(element.tag, {})
        values, joint = {**of_class, **element.attrib}, element.get("joint", "")
        place = f"actuator of joint {joint}"
        own = _own_gains(element.tag, values, path, place)
        if joint in joints and own is not None:
            gear = _first(values, "gear", path, place)
            gains[joint] = gear**2 * np.array(own)
    if not gains:
        return ()
    kp, kd = np.array([gains.get(name, np.zeros(2)) for name in joints]).T
    listed = [", ".join(f"{gain:g}" for gain in each) for each in (kp, kd)]
    return (
        f"{path}: its actuators hold positions; as the controller: of a case, kp: [{listed[0]}], kd: [{listed[1]}] at "
        "the rate of the simulation",
    )


def _own_gains(
    tag: str, values: Attributes, path: Path, place: str
) -> tuple[float, float] | None:
    """kp and kd of an actuator before its gear, ``None`` of one that holds neither position nor velocity."""
    if tag == "position":
        kv = values.get("kv", "0")
        return _first(values, "kp", path, place), float(
            numbers(kv, 1, path, f"{place}, kv")[0]
        )
    if tag == "velocity":
        return 0.0, _first(values, "kv", path, place)
    if tag == "general" and values.get("biastype") == "affine":
        bias = numbers(values.get("biasprm", "0"), None, path, f"{place}, biasprm")
        _, kp, kd = np.r_[-bias, 0.0, 0.0][:3]
        return float(kp), float(kd)
    return None


def _first(values: Attributes, name: str, path: Path, place: str) -> float:
    """Size of the first number of an attribute, 1 by default."""
    text = values.get(name, "1")
    return float(abs(numbers(text, None, path, f"{place}, {name}")[0]))


def _range(values: Attributes, of: str, path: Path, place: str) -> float:
    """What a range allows to either side; infinite if there is none."""
    text = values.get(f"{of}range")
    if text is None or values.get(f"{of}limited", "auto") == "false":
        return np.inf
    return float(np.abs(numbers(text, 2, path, f"{place}, {of}range")).min())
