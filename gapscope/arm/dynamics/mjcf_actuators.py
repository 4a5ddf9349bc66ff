"""Actuators of an MJCF file: what they allow at the joints, and the gains of those that hold a position."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gapscope.arm.dynamics.mjcf import (
    Attributes,
    default_classes,
    joint_attributes,
    numbers,
)

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
