"""What an MJCF file says beside bodies and joints: gravity, actuators, and what is left out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.description import Description, coefficients
from gapscope.arm.errors import InputError

UNREAD = {
    "tendon": "<tendon>",
    "compiler[@settotalmass]": "<compiler settotalmass>",
}
"""What is passed over, by its path in the file."""
UNFOLDED = ("include", "replicate", "attach", "frame//body", "frame//joint")
"""Elements that contain or change bodies, and are not expanded here."""
UNWEIGHED = ("mesh", "plane", "hfield", "sdf")
"""Shapes whose mass is not known here."""


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
        wanted = "numbers" if count is None else f"{count} numbers"
        raise InputError(
            f"expected {'a number' if count == 1 else wanted}, got {text!r}",
            "correct the attribute",
            file=path,
            where=where,
        )
    return values


def gravity(description: Description) -> np.ndarray | None:
    """Gravity of ``<option>`` in the world's frame [m/s^2], shape (3,); ``None`` if the file does not say.

    Raises:
        InputError: it is not three numbers.
    """
    root = description.root
    if root.find("option/flag[@gravity='disable']") is not None:
        return np.zeros(3)
    given = [option.get("gravity", "") for option in root.findall("option[@gravity]")]
    if not given:
        return None
    return numbers(given[-1], 3, description.file, "<option gravity>")


def check_references(description: Description, joints: Sequence[str]) -> None:
    """Check that the positions of these joints count from the pose that the file draws.

    Raises:
        InputError: the ``ref`` of a joint is not zero.
    """
    for name, joint in _joints(description, joints):
        ref = joint.get("ref", "0")
        if numbers(ref, 1, description.file, f"joint {name}, ref").any():
            raise InputError(
                f"ref is {ref}, expected 0: positions count from the pose in which the file draws the arm",
                "leave ref out and turn the body by it, or move the recorded positions",
                file=description.file,
                where=f"joint {name}",
            )


def _joints(
    description: Description, names: Sequence[str]
) -> Iterator[tuple[str, ET.Element]]:
    """Elements of some joints."""
    for joint in description.root.iter("joint"):
        name = joint.get("name", "")
        if name in names and name in description.single:
            yield name, joint


def left_out(description: Description, joints: Sequence[str]) -> tuple[str, ...]:
    """What acts on an arm by its file and is not simulated, a sentence each."""
    root, path = description.root, description.file
    notes = [
        f"{what} is not read"
        for place, what in UNREAD.items()
        if root.find(place) is not None
    ]
    notes += _unread_equality(root)
    for link in description.links:
        if link.drawn and link.inertial is None and description.is_moved(link.name):
            notes.append(
                f"body {link.name} has no <inertial> and is weighed by its shapes; give it one"
            )
    for body in root.iter("body"):
        name = body.get("name")
        if numbers(body.get("gravcomp", "0"), 1, path, f"body {name}, gravcomp").any():
            notes.append(
                f"gravcomp of body {name} is not read: its weight is not held up"
            )
    for name, joint in _joints(description, joints):
        stiffness = joint.get("stiffness", "0")
        if numbers(stiffness, None, path, f"joint {name}, stiffness").any():
            notes.append(
                f"the spring of joint {name} (stiffness {stiffness}, springref {joint.get('springref', '0')}) is not "
                "read; give it as the effect parallel_spring"
            )
    return tuple(f"{path}: {note}" for note in notes)


def _unread_equality(root: ET.Element) -> Iterator[str]:
    """Constraints other than joints that follow another one in proportion."""
    for element in root.findall("equality/*"):
        terms = coefficients(element)
        straight = terms is not None and not terms[2:].any()
        if element.tag == "joint" and element.get("joint2") and straight:
            continue
        ends = (element.get(key) for key in ("joint1", "joint2", "body1", "body2"))
        between = ", ".join(filter(None, ends)) or "unnamed parts"
        yield (
            f"<equality><{element.tag}> of {between} is not read: what it holds together moves freely, or is locked if "
            "it is none of the arm's joints"
        )


# --- actuators: what they allow at the joints, and the gains of those that hold a position


class _Actuator(NamedTuple):
    """An actuator of a joint: its element, the size of its gear [1], and its file and place for messages."""

    element: ET.Element
    joint: str
    gear: float
    path: Path

    def first(self, name: str) -> float:
        """Size of the first number of an attribute."""
        return float(abs(self.all(name, "1")[0]))

    def all(self, name: str, default: str) -> np.ndarray:
        """Numbers of an attribute."""
        text, place = self.element.get(name, default), f"actuator of joint {self.joint}"
        return numbers(text, None, self.path, f"{place}, {name}")

    def range(self, of: str) -> float:
        """What a range allows to either side; infinite if there is none."""
        return _range(self.element, of, self.path, f"actuator of joint {self.joint}")


def _range(element: ET.Element, of: str, path: Path, place: str) -> float:
    text = element.get(f"{of}range")
    if text is None or element.get(f"{of}limited", "auto") == "false":
        return np.inf
    return float(np.abs(numbers(text, 2, path, f"{place}, {of}range")).min())


def _actuators(description: Description) -> Iterator[_Actuator]:
    for element in description.root.findall("actuator/*"):
        one = _Actuator(element, element.get("joint", ""), 1.0, description.file)
        yield one._replace(gear=one.first("gear"))


DRIVES = ("general", "motor")
"""Actuators of which a limit of the control is one of the torque."""


def torque_limits(description: Description) -> dict[str, float]:
    """Torque limit of each joint that has one [N m]: the least that the joint and its actuators allow, to either side.

    A joint's ``actuatorfrcrange``, an actuator's ``forcerange``, and of motors ``ctrlrange``, both times its gear.

    Raises:
        InputError: a range is not two numbers.
    """
    path = description.file
    limits = {
        name: _range(joint, "actuatorfrc", path, f"joint {name}")
        for name, joint in _joints(description, tuple(description.single))
    }
    for one in _actuators(description):
        limit = one.range("force")
        # only of a plain motor the control is a torque
        plain = one.element.get("biastype", "none") == "none"
        if one.element.tag in DRIVES and plain:
            limit = min(limit, one.first("gainprm") * one.range("ctrl"))
        limits[one.joint] = min(limits.get(one.joint, np.inf), one.gear * limit)
    return {joint: limit for joint, limit in limits.items() if limit < np.inf}


def position_gains(description: Description, joints: Sequence[str]) -> tuple[str, ...]:
    """A note with the gains of position actuators as the ``controller:`` of a case, if the arm's joints have any.

    A ``position`` actuator commands gear kp (u - gear q) - gear^2 kv dq: kp and kd about the joint are gear^2 times its
    own; a ``general`` one whose ``biastype`` is affine has kp and kd in ``biasprm`` [b0, -kp, -kd].
    """
    gains = {}
    for one in _actuators(description):
        if one.joint in joints and (own := _own_gains(one)) is not None:
            gains[one.joint] = one.gear**2 * np.array(own)
    if not gains:
        return ()
    kp, kd = np.array([gains.get(name, np.zeros(2)) for name in joints]).T
    listed = [", ".join(f"{gain:g}" for gain in each) for each in (kp, kd)]
    return (
        f"{description.file}: its actuators hold positions; as the controller: of a case, kp: [{listed[0]}], kd: "
        f"[{listed[1]}] at the rate of the simulation",
    )


def _own_gains(one: _Actuator) -> tuple[float, float] | None:
    """kp and kd of an actuator before its gear, ``None`` of one that holds neither position nor velocity."""
    if one.element.tag == "position":
        return one.first("kp"), float(one.all("kv", "0")[0])
    if one.element.tag == "velocity":
        return 0.0, one.first("kv")
    if one.element.tag == "general" and one.element.get("biastype") == "affine":
        _, kp, kd = np.r_[-one.all("biasprm", "0"), 0.0, 0.0][:3]
        return float(kp), float(kd)
    return None
