"""Tree, axes, limits, friction and rotors of the joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gapscope.model_audit.description import Description, Joint
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.thresholds import AXIS_LENGTH, SAME_ON_JOINTS

LIMITS = {"effort": "torque limit", "velocity": "velocity limit"}
DRIVE = {
    "damping": "viscous friction",
    "friction": "dry friction",
    "armature": "rotor inertia",
}

FIELDS = {"damping": "viscous", "friction": "coulomb", "armature": "armature"}
"""Entries of a case's data sheet for these."""


def check_joints(description: Description) -> Iterator[Finding]:
    """What is odd about the joints, each one and all together."""
    yield from _tree(description)
    for joint in description.moving:
        yield from _axis(joint)
        yield from _limits(joint, description.form)
    yield from _values_of_all(description)


def _tree(description: Description) -> Iterator[Finding]:
    """Links that joints name and the file lacks, links that two joints hold, and joints of other kinds."""
    names = {link.name for link in description.links}
    held = Counter(joint.child for joint in description.joints)
    for joint in description.joints:
        for end in (joint.parent, joint.child):
            if end not in names:
                yield _finding(
                    "impossible",
                    "no_such_link",
                    joint,
                    f"names the link {end!r}, which the file does not have",
                    "links of the file",
                    "correct the name",
                    1e3,
                )
        if held[joint.child] > 1:
            yield _finding(
                "impossible",
                "held_twice",
                joint,
                f"{held[joint.child]} joints hold the link {joint.child}",
                "a tree: one joint above each link",
                "remove the joints that close a loop",
                1e3,
            )
    below = {link.name for link in description.in_tree_order()}
    for link in description.links:
        if link.name not in below:
            yield Finding(
                "impossible",
                "loop",
                f"link {link.name}",
                link.line,
                "hangs on a loop of joints, not on the base",
                "a tree of links from one base",
                "correct <parent> and <child> of its joints",
                1e3,
            )


def _axis(joint: Joint) -> Iterator[Finding]:
    length = float(np.linalg.norm(joint.axis))
    if length < AXIS_LENGTH:
        yield _finding(
            "impossible",
            "axis",
            joint,
            "its axis has length zero",
            "an axis of length one",
            "correct <axis>",
            1e2,
        )
    elif abs(length - 1) > AXIS_LENGTH:
        yield _finding(
            "note",
            "axis",
            joint,
            f"its axis has the length {length:.6g}",
            "length one; readers scale it, or do not",
            "divide it by its length",
            abs(length - 1),
        )


def _limits(joint: Joint, form: str) -> Iterator[Finding]:
    lower, upper = joint.lower, joint.upper
    if not joint.turns_freely and form == "URDF":
        if lower is None and upper is None and joint.effort is None:
            yield _finding(
                "missing",
                "limits",
                joint,
                "has no <limit>, which a URDF requires",
                "lower, upper, effort and velocity",
                'give them, or type="continuous" if it turns without end',
                0.5,
            )
        elif (lower or 0.0) >= (upper or 0.0):
            yield _finding(
                "implausible",
                "limits",
                joint,
                f"lower limit {lower or 0:g}, upper limit {upper or 0:g}: some readers lock it, others free it",
                "lower below upper",
                'give the range of the data sheet, or type="continuous" if it turns without end',
                0.5,
            )
    for name, meaning in LIMITS.items():
        value = getattr(joint, name)
        if value is not None and value <= 0:
            yield _finding(
                "implausible",
                name,
                joint,
                f"{meaning} {value:g}",
                "a limit above zero",
                f"give the {meaning} of the data sheet; simulators clip at it",
                0.3,
            )


def _values_of_all(description: Description) -> Iterator[Finding]:
    """Limits, friction and rotors that no joint has, or all have alike."""
    joints = description.moving
    if not joints:
        return
    absent = []
    for name, meaning in {**LIMITS, **DRIVE}.items():
        given = [value for joint in joints if (value := getattr(joint, name))]
        if not given and name in DRIVE:
            absent.append(name)
        elif len(given) >= SAME_ON_JOINTS and len(set(given)) == 1:
            identify = ", or identify it (gapscope identify)" if name in DRIVE else ""
            yield Finding(
                "missing" if name in DRIVE else "note",
                f"same_{name}",
                "",
                joints[0].line,
                f"{meaning} {given[0]:g} on {len(given)} of {len(joints)} joints",
                "a value of each joint's own drive",
                f"looks like a placeholder: give the data sheet's{identify}",
                0.2,
            )
    if absent:
        yield _no_drive(description, absent)


def _no_drive(description: Description, absent: list[str]) -> Finding:
    """Friction or rotors that no joint has."""
    found = f"no joint has {' or '.join(DRIVE[name] for name in absent)}"
    if description.form == "URDF" and "armature" in absent:
        found += "; a URDF has no place for rotors"
    fields = ", ".join(f"{FIELDS[name]}: [...]" for name in absent)
    return Finding(
        "missing",
        "no_drive",
        "",
        0,
        found,
        "friction and rotors of the gears make up much of the torque of most arms",
        f"give nominal: {{{fields}}} in case.yaml from the data sheet, or identify the arm (gapscope identify)",
        0.1,
    )


def _finding(
    severity: str,
    kind: str,
    joint: Joint,
    found: str,
    expected: str,
    remedy: str,
    size: float,
) -> Finding:
    return Finding(
        severity,
        kind,
        f"joint {joint.name}",
        joint.line,
        found,
        expected,
        remedy,
        size,
    )
