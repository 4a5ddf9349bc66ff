"""The arm of a robot's file as pinocchio has it: its bodies and joints checked, all other joints locked."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import (
    SEVERAL,
    SINGLE,
    Description,
    Inertial,
    Joint,
    Link,
    Mimic,
    Place,
    Shape,
    coefficients,
    read_description,
)
from gapscope.arm.errors import InputError
from gapscope.arm.io.table import shortened
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import check_size

SAME_INERTIA = 4
"""So many links of different masses with the same moments of inertia have no moments of their own [1]."""
ROUNDING = 1e-15
"""Moments of inertia this far below zero are rounding of a file that was converted [kg m^2]."""
UNLIMITED = 1e6
"""Position limits beyond this [rad or m] are none."""


UNREAD = {
    "tendon": "<tendon>",
    "compiler[@settotalmass]": "<compiler settotalmass>",
}
"""What is passed over, by its path in the file."""
UNFOLDED = ("include", "replicate", "attach", "frame//body", "frame//joint")
"""Elements that contain or change bodies, and are not expanded here."""
UNWEIGHED = ("mesh", "plane", "hfield", "sdf")
"""Shapes whose mass is not known here."""


# --- checks


def checked(description: Description, joints: Collection[str] = ()) -> Description:
    """What of a file concerns an arm, checked; impossible inertials of links that do not move with it are left out.

    Args:
        description: of the file.
        joints: the arm's; by default none, and all of the file's tree is checked.

    Raises:
        InputError: a number is none, the joints are no tree, or a body that moves is none that can be.
    """
    path, moved = description.file, description.moved(joints)
    links = description.around(joints)
    used = tuple(j for j in description.joints if not joints or j.child in links)
    places = {f"joint {joint.name}" for joint in used}
    tag = "link" if description.form == "URDF" else "body"
    places |= {f"{tag} {name}" for name in moved}
    places |= {f"shape of {tag} {name}" for name in moved & _by_shape(description)}
    poses = {f"body {joint.child}" for joint in used}
    for found in description.unreadable:
        other = found.place.removeprefix("joint ") not in joints
        # the limits of a joint that is locked have no say
        idle = joints and other and found.element.startswith("<limit")
        posed = found.place in poses and not found.element.startswith("<inertial")
        if posed or (found.place in places and not idle):
            raise found.error(path)
    for element in UNFOLDED:
        if description.root.find(f".//{element}") is not None:
            name = element.split("//")[0]
            raise InputError(
                f"<{name}> is not read", "expand it in the file", file=path
            )
    bases = [x.name for x in description.links if x.name not in description.above]
    _check_tree(description, used, () if joints else bases)
    for joint in used:
        _check_joint(joint, path)
    faults = inertial_faults(description)
    for name, fault in faults.items():
        if name in moved:
            raise fault
    kept = [
        replace(link, inertial=None) if link.name in faults else link
        for link in description.links
    ]
    return replace(description, links=tuple(kept), joints=used)


def inertial_faults(description: Description) -> dict[str, InputError]:
    """What is wrong with inertials that no body can have, by the name of the link.

    A number is missing or none, a mass or a principal moment is negative, a body without inertial has no known weight.
    """
    faults = {}
    tag = "link" if description.form == "URDF" else "body"
    unreadable = {one.place: one for one in description.unreadable}
    for link in description.links:
        found = unreadable.get(f"{tag} {link.name}")
        try:
            if found is not None:
                raise found.error(description.file)
            if link.inertial is not None:
                where = f"line {link.inertial.line}, {tag} {link.name}, <inertial>"
                _check_inertial(link.inertial, description.file, where)
            elif (bad := _unweighed(description, link)) is not None:
                raise InputError(
                    f"has no <inertial>, and its mass cannot be taken from the shape {bad.named or bad.kind}",
                    'give it one; MuJoCo\'s mj_saveLastXML writes it after <compiler saveinertial="true"/>',
                    file=description.file,
                    where=f"line {link.line}, body {link.name}",
                )
        except InputError as error:
            faults[link.name] = error
    return faults


def _check_inertial(inertial: Inertial, path: Path, where: str) -> None:
    if inertial.mass < 0:
        raise InputError(
            f"mass is {inertial.mass:g} kg, expected zero or above",
            "correct its value",
            file=path,
            where=where,
        )
    check_size(inertial.mass, "mass", path, where)
    check_size(inertial.moments, "moment of inertia", path, where)
    check_size(inertial.com, "length", path, where)
    moments = np.linalg.eigvalsh(inertial.moments)
    if moments[0] < -max(1e-6 * abs(moments[2]), ROUNDING):
        raise InputError(
            f"it has the principal moments {listed(moments)} kg m^2, expected none below zero",
            "correct the moments: they are about the centre of mass, in the axes of the inertial's frame",
            file=path,
            where=where,
        )


def listed(moments: np.ndarray) -> str:
    """Principal moments as text [kg m^2], shape (3,)."""
    return ", ".join(f"{moment:.4g}" for moment in moments)


def _check_joint(joint: Joint, path: Path) -> None:
    where = f"line {joint.line}, joint {joint.name}"
    check_size(joint.place.translation, "length", path, where)
    if joint.kind in SINGLE and not np.linalg.norm(joint.axis) > 0:
        raise InputError(
            "its axis has no direction, so that it moves nothing",
            'correct <axis xyz="...">, or axis of an MJCF file',
            file=path,
            where=where,
        )
    for name in ("effort", "velocity", "friction"):
        limit = getattr(joint, name)
        if limit is not None and limit < 0:
            raise InputError(
                f"its {name} is {limit:g}, expected zero or above",
                "correct the attribute, or leave it out",
                file=path,
                where=where,
            )


def _check_tree(
    description: Description, joints: Sequence[Joint], bases: Sequence[str]
) -> None:
    """Check that joints hold links of the file in one tree, and that there is no other base."""
    held = Counter(joint.child for joint in joints)
    names = Counter(joint.name for joint in joints)
    known = Counter(link.name for link in description.links)
    roots = dict.fromkeys(bases)
    for joint in joints:
        problem = ""
        ends = [end for end in (joint.parent, joint.child) if known[end] != 1]
        *_, top = description.upwards(joint.child)
        if ends and not known[ends[0]]:
            problem = f"names the link {ends[0]!r}, which the file does not have"
        elif ends:
            problem = (
                f"names the link {ends[0]!r}, of which the file has {known[ends[0]]}"
            )
        elif held[joint.child] > 1:
            problem = f"holds the link {joint.child}, and so do others"
        elif joint.moves and (not joint.name or names[joint.name] > 1):
            problem = "needs a name of its own"
        elif top.parent in description.above:
            problem = f"its joints close a loop at the link {joint.child!r}"
        roots[top.parent] = None
        if problem:
            raise InputError(
                problem,
                "correct the file: the links of an arm hang on one base, one joint above each; or name the arm in "
                "chain: or joints: of the case, and what does not concern it is not read",
                file=description.file,
                where=f"line {joint.line}, joint {joint.name}",
            )
    if len(roots) > 1:
        raise InputError(
            f"has several bases: {', '.join(roots)}",
            "name the arm in chain: or joints: of the case, and what does not concern it is not read",
            file=description.file,
        )


# --- bodies that an MJCF file weighs by their shapes


def _by_shape(description: Description) -> set[str]:
    """Links without inertial that have shapes of an MJCF file."""
    if description.form == "URDF":
        return set()
    return {x.name for x in description.links if x.drawn and x.inertial is None}


def _unweighed(description: Description, link: Link) -> Shape | None:
    """A shape of a moved body of an MJCF file whose mass is not known here, though the body has no inertial."""
    moved = any(joint.kind in SINGLE for joint in description.upwards(link.name))
    if description.form == "URDF" or not moved:
        return None
    return next((s for s in link.drawn if s.kind in UNWEIGHED or s.named), None)


def _weighed(shape: Shape) -> pin.Inertia:
    """Inertia of a homogeneous shape in its link's frame."""
    a, rest = shape.size[0], float(np.prod(shape.size[1:]))
    ball, disc = 4 / 3 * np.pi * a**3, np.pi * a**2
    make, volume = {
        "box": (pin.Inertia.FromBox, a * rest),
        "sphere": (pin.Inertia.FromSphere, ball),
        "ellipsoid": (pin.Inertia.FromEllipsoid, 4 / 3 * np.pi * a * rest),
        "cylinder": (pin.Inertia.FromCylinder, disc * rest),
        "capsule": (pin.Inertia.FromCapsule, ball + disc * rest),
    }[shape.kind]
    mass = shape.density * volume if shape.mass is None else shape.mass
    return _frame(shape.place).act(make(float(mass), *shape.size))


# --- the model


def arm_model(
    path: Path,
    joints: Sequence[str],
    gravity: Sequence[float] | np.ndarray,
    locked: Mapping[str, float] | None = None,
) -> pin.Model:
    """Model of some joints of a file, without armature, under a gravity [m/s^2].

    Args:
        path: URDF or MJCF file.
        joints: those that move.
        gravity: in the base frame [m/s^2], shape (3,).
        locked: positions of other joints [rad or m]; those that are not named are locked at zero.

    Raises:
        InputError: the file lacks one of the joints, or what concerns them is no arm that can be.
    """
    description = checked(read_description(path, shapes=False), joints)
    missing = [name for name in joints if name not in description.single]
    if missing:
        raise InputError(
            f"has no movable joint {', '.join(missing)}; it has {', '.join(description.single)}",
            "name the joints of the recording's columns in joints:, or give the URDF of the recorded arm",
            file=path,
        )
    model, positions = pin.Model(), locked or {}
    held = {joint.child for joint in description.joints}
    bases = [joint.parent for joint in description.joints if joint.parent not in held]
    # link by link from the base on, each with the joint above it and the body and place that carry this joint
    waiting: list[tuple[Joint | None, str, int, pin.SE3]]
    waiting = [(None, base, 0, pin.SE3.Identity()) for base in bases[:1]]
    while waiting:
        joint, name, body, place = waiting.pop()
        if joint is not None:
            place = place * _frame(joint.place) * pin.SE3(np.eye(3), joint.anchor)
            if joint.name in joints:
                body, place = _add_joint(model, joint, body, place), pin.SE3.Identity()
            elif joint.kind in SINGLE and positions.get(joint.name):
                moved = joint.axis / np.linalg.norm(joint.axis) * positions[joint.name]
                if joint.kind == "revolute":
                    place = place * pin.SE3(pin.exp3(moved), np.zeros(3))
                else:
                    place = place * pin.SE3(np.eye(3), moved)
            place = place * pin.SE3(np.eye(3), -joint.anchor)
        link = description.by_name[name]
        if (own := link.inertial) is not None:
            inertia = pin.Inertia(own.mass, own.com, own.moments)
            model.appendBodyToJoint(body, inertia, place)
        elif body and link.drawn and description.form == "MJCF":
            for shape in link.shapes:
                model.appendBodyToJoint(body, _weighed(shape), place)
        if link.line:
            frame = pin.Frame(link.name, body, place, pin.FrameType.BODY)
            model.addFrame(frame, False)
        for below in reversed(description.below(name)):
            waiting.append((below, below.child, body, place))
    if description.form == "MJCF":
        for name, limit in torque_limits(description).items():
            if model.existJointName(name):
                model.effortLimit[model.joints[model.getJointId(name)].idx_v] = limit
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    return model


def _frame(place: Place) -> pin.SE3:
    return pin.SE3(place.rotation, place.translation)


def _add_joint(model: pin.Model, joint: Joint, body: int, place: pin.SE3) -> int:
    """Add a joint that moves; the number of the body that it carries."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    aligned = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
    free = pin.JointModelRevoluteUnaligned
    if joint.kind == "prismatic":
        aligned = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
        free = pin.JointModelPrismaticUnaligned
    motion = aligned[axis.argmax()]() if axis.max() == 1.0 else free(axis)
    lower, upper = joint.lower or 0.0, joint.upper or 0.0
    if joint.turns_freely or lower >= upper:
        lower, upper = -np.inf, np.inf
    bounds = np.array([joint.effort or 0.0, joint.velocity or 0.0, lower, upper])
    number = model.addJoint(body, motion, place, joint.name, *bounds[:, None])
    return int(number)


# --- what a data sheet may take from a file


def actuated_joints(description: Description) -> list[str]:
    """Names of the movable joints of a file in kinematic order, but for those that follow another."""
    names = [description.above.get(x.name) for x in description.in_tree_order()]
    return [joint.name for joint in names if joint is not None and joint.moves]


def placeholder(description: Description, joints: Collection[str]) -> str:
    """What says that the moments of inertia of an arm of a URDF stand in for unknown ones; empty if they do not."""
    moved = description.moved(joints)
    masses: dict[bytes, set[float]] = {}
    for link in description.links:
        if link.name in moved and link.inertial is not None:
            own = masses.setdefault(link.inertial.own.tobytes(), set())
            own.add(link.inertial.mass)
    most = max(masses.values(), key=len, default=set())
    if len(most) < SAME_INERTIA or description.form != "URDF":
        return ""
    return (
        f"{description.file}: links of {len(most)} different masses have the same moments of inertia, placeholders "
        "that are not the arm's: its torque cannot be judged by them; give its published inertials"
    )


def silent_limits(description: Description, joints: Collection[str]) -> list[str]:
    """What the ``<limit>`` of joints of a URDF does not say, effort or velocity, a sentence for each joint."""
    notes = []
    for joint in description.joints if description.form == "URDF" else ():
        lacking = [key for key in ("effort", "velocity") if getattr(joint, key) is None]
        free = joint.turns_freely and len(lacking) == 2
        if joint.name in joints and lacking and not free:
            notes.append(
                f"{description.file}, joint {joint.name}: <limit> does not say {' and '.join(lacking)}: none is known"
            )
    return notes


# Joints of a robot file beside the arm's: where they are locked, and those that follow a joint of the arm.


NAMED = 6
"""Joints that a note names; the others are counted."""


def lock(
    tree: Description, joints: Sequence[str], given: Mapping[str, float]
) -> tuple[dict[str, float], np.ndarray, list[str]]:
    """Lock all joints of a file but the arm's.

    A joint that follows another one is locked where that one puts it. If it follows a joint of the arm, it is locked
    where that joint's zero puts it, and its inertia counts on that joint as armature, m^2 M_ff + 2 m M_fj with the
    multiplier m and the mass matrix M at zero; the change of its gravity torque is left out.

    Args:
        tree: joints of the file.
        joints: names of the arm's joints.
        given: positions of locked joints [rad or m].

    Returns:
        Positions of those that do not stand at zero, and of those that follow one of the arm's [rad or m]; inertia that
        these add to the arm's joints [kg m^2 or kg], shape (n,); and a sentence for each thing that was assumed.

    Raises:
        InputError: a position is given of a joint that does not exist, or that is one of the arm's.
    """
    single = tree.single
    for name in given:
        if name in joints:
            raise InputError(
                f"{name} is one of the arm's joints, and locked",
                "take it out of locked:, or out of joints: or chain:",
                file=tree.file,
                where="field locked",
            )
        if name not in single:
            raise InputError(
                f"has no movable joint {name!r}",
                f"{nearest(name, single)}it has {', '.join(single)}",
                file=tree.file,
                where="field locked",
            )
    positions = {name: float(position) for name, position in given.items() if position}
    followers: dict[str, Mimic] = {}
    for name in single:
        if name in joints or name in given:
            continue
        rule = _chain_of_masters(name, single)
        at_master = float(given.get(rule.master, 0.0))
        position = rule.multiplier * at_master + rule.offset
        if rule.master in joints:
            followers[name] = rule
        if position or rule.master in joints:
            positions[name] = position
    positions = {name: positions[name] for name in single if name in positions}
    notes = _notes(tree, joints, given)
    notes += [
        f"{tree.file}: {name} follows {rule.master}: its inertia counts there as armature, its change of gravity "
        "torque is left out"
        for name, rule in followers.items()
    ]
    return positions, _reflected(tree.file, joints, positions, followers), notes


def _chain_of_masters(name: str, single: Mapping[str, Joint]) -> Mimic:
    """The joint that one follows at last, with the multiplier and the offset of all between; itself if it does not."""
    last, multiplier, offset = name, 1.0, 0.0
    for _ in single:
        joint = single.get(last)
        if joint is None or joint.mimic is None:
            break
        offset += multiplier * joint.mimic.offset
        multiplier *= joint.mimic.multiplier
        last = joint.mimic.master
    return Mimic(last, multiplier, offset)


def _reflected(
    path: Path,
    joints: Sequence[str],
    positions: Mapping[str, float],
    followers: Mapping[str, Mimic],
) -> np.ndarray:
    """Inertia of the followers on their masters [kg m^2 or kg], shape (n,)."""
    added = np.zeros(len(joints))
    if not followers:
        return added
    model = arm_model(path, (*joints, *followers), np.zeros(3), positions)
    posture = pin.neutral(model)
    for name in followers:
        posture[model.joints[model.getJointId(name)].idx_q] = positions[name]
    mass = pin.crba(model, model.createData(), posture)
    mass = np.triu(mass) + np.triu(mass, 1).T
    column = {name: model.joints[model.getJointId(name)].idx_v for name in model.names}
    for name, rule in followers.items():
        own, master = column[name], column[rule.master]
        m = rule.multiplier
        added[list(joints).index(rule.master)] += (
            m**2 * mass[own, own] + 2 * m * mass[own, master]
        )
    return np.maximum(added, 0.0)


def _notes(
    tree: Description, joints: Sequence[str], given: Mapping[str, float]
) -> list[str]:
    """Joints locked at zero that count: those that the arm carries, and those that carry the arm."""
    moved, carriers = tree.moved(joints), tree.carriers(joints)
    silent, fixed = [], []
    for joint in tree.joints:
        # a slide that carries the arm moves it without turning it against gravity
        mounts = joint.name in carriers and joint.kind != "prismatic"
        if joint.name in joints or not (joint.child in moved or mounts):
            continue
        if joint.kind in SEVERAL:
            fixed.append(joint.name or f"the joint of {joint.child}")
        elif joint.moves and joint.name not in given:
            silent.append(joint.name)
    notes = []
    if silent:
        notes.append(
            f"{tree.file}: locked at zero: {shortened(silent, NAMED)}; if one stood elsewhere, say so in locked: of "
            "the case"
        )
    if fixed:
        notes.append(
            f"{tree.file}: fixed as the file draws it, for it has several degrees of freedom: "
            f"{shortened(fixed, NAMED)}"
        )
    return notes


# --- what an MJCF file says beside bodies and joints: gravity, actuators, and what is left out


def _numbers(text: str, count: int | None, path: Path, where: str) -> np.ndarray:
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


def gravity_of(description: Description) -> np.ndarray | None:
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
    return _numbers(given[-1], 3, description.file, "<option gravity>")


def check_references(description: Description, joints: Sequence[str]) -> None:
    """Check that the positions of these joints count from the pose that the file draws.

    Raises:
        InputError: the ``ref`` of a joint is not zero.
    """
    for name, joint in _joints(description, joints):
        ref = joint.get("ref", "0")
        if _numbers(ref, 1, description.file, f"joint {name}, ref").any():
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
        if _numbers(body.get("gravcomp", "0"), 1, path, f"body {name}, gravcomp").any():
            notes.append(
                f"gravcomp of body {name} is not read: its weight is not held up"
            )
    for name, joint in _joints(description, joints):
        stiffness = joint.get("stiffness", "0")
        if _numbers(stiffness, None, path, f"joint {name}, stiffness").any():
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
    """An actuator of a joint: its element, its file for messages, and the size of its gear [1]."""

    element: ET.Element
    path: Path
    gear: float = 1.0

    @property
    def joint(self) -> str:
        """Name of the joint that it moves."""
        return self.element.get("joint", "")

    def first(self, name: str) -> float:
        """Size of the first number of an attribute."""
        return float(abs(self.all(name, "1")[0]))

    def all(self, name: str, default: str) -> np.ndarray:
        """Numbers of an attribute."""
        where = f"actuator of joint {self.joint}, {name}"
        return _numbers(self.element.get(name, default), None, self.path, where)

    def range(self, of: str) -> float:
        """What a range allows to either side; infinite if there is none."""
        return _range(self.element, of, self.path, f"actuator of joint {self.joint}")


def _range(element: ET.Element, of: str, path: Path, place: str) -> float:
    text = element.get(f"{of}range")
    if text is None or element.get(f"{of}limited", "auto") == "false":
        return np.inf
    return float(np.abs(_numbers(text, 2, path, f"{place}, {of}range")).min())


def _actuators(description: Description) -> Iterator[_Actuator]:
    for element in description.root.findall("actuator/*"):
        one = _Actuator(element, description.file)
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
