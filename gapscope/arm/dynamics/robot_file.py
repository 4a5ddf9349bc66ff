"""The arm of a robot's file as pinocchio has it: its bodies and joints checked, all other joints locked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import (
    SEVERAL,
    SINGLE,
    Description,
    Inertial,
    Joint,
    Mimic,
    Shape,
    read_description,
)
from gapscope.arm.errors import InputError
from gapscope.arm.io.table import shortened
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import LARGEST, check_size

SAME_INERTIA = 4
"""So many links of different masses with the same moments of inertia have no moments of their own [1]."""
UNLIMITED = LARGEST["length"][0]
"""Position limits beyond this [rad or m] are none."""


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
    # of the whole file if no arm is named, else of what concerns it
    used = tuple(j for j in description.joints if not joints or j.child in links)
    places = {f"joint {joint.name}" for joint in used}
    tag = "link" if description.form == "URDF" else "body"
    places |= {f"{tag} {name}" for name in moved}
    for found in description.unreadable:
        other = found.place.removeprefix("joint ") not in joints
        # the limits of a joint that is locked have no say
        idle = joints and other and found.element.startswith("<limit")
        if found.place in places and not idle:
            raise found.error(path)
    bases = [x.name for x in description.links if x.name not in description.above]
    # of an arm named by its joints other bases of the file do not matter
    _check_tree(description, used, () if joints else bases)
    for joint in used:
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
        if joint.name in joints and joint.reference:
            raise InputError(
                f"ref is {joint.reference:g}, expected 0: positions count from the pose that the file draws",
                "leave ref out and turn the body by it, or move the recorded positions",
                file=path,
                where=f"joint {joint.name}",
            )
    faults = inertial_faults(description)
    for name, fault in faults.items():
        if name in moved:
            raise fault
    # those that stand still may have any inertial: it is left out
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
            elif description.form == "MJCF" and any(
                joint.kind in SINGLE for joint in description.upwards(link.name)
            ):
                # a shape whose mass is not known here
                bad = next(
                    (s for s in link.drawn if s.kind in UNWEIGHED or s.named), None
                )
                if bad is None:
                    continue
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
    # a negative moment within rounding of the largest one, or of a conversion
    if moments[0] < -max(1e-6 * abs(moments[2]), np.finfo(float).eps):
        raise InputError(
            f"it has the principal moments {listed(moments)} kg m^2, expected none below zero",
            "correct the moments: they are about the centre of mass, in the axes of the inertial's frame",
            file=path,
            where=where,
        )


def listed(moments: np.ndarray) -> str:
    """Principal moments as text [kg m^2], shape (3,)."""
    return ", ".join(f"{moment:.4g}" for moment in moments)


def tree_faults(
    description: Description, joints: Sequence[Joint]
) -> Iterator[tuple[str, Joint, str]]:
    """What keeps joints from holding links of the file in one tree: a word for it, the joint, and the problem."""
    held = Counter(joint.child for joint in joints)
    names = Counter(joint.name for joint in joints)
    known = Counter(link.name for link in description.links)
    for joint in joints:
        # each end once in the file, or the joint hangs nowhere
        odd = [end for end in (joint.parent, joint.child) if known[end] != 1]
        # the way up ends at the base, or goes round
        *_, top = description.upwards(joint.child)
        if odd and not known[odd[0]]:
            said = f"names the link {odd[0]!r}, which the file does not have"
            yield "no_such_link", joint, said
        elif odd:
            said = f"names the link {odd[0]!r}, of which the file has {known[odd[0]]}"
            yield "same_name", joint, said
        elif held[joint.child] > 1:
            yield (
                "held_twice",
                joint,
                f"holds the link {joint.child}, and so do others",
            )
        elif joint.moves and (not joint.name or names[joint.name] > 1):
            yield "same_name", joint, "needs a name of its own"
        elif top.parent in description.above:
            yield "loop", joint, f"its joints close a loop at the link {joint.child!r}"


def _check_tree(
    description: Description, joints: Sequence[Joint], bases: Sequence[str]
) -> None:
    """Check that joints hold links of the file in one tree, and that there is no other base."""
    for _, joint, problem in tree_faults(description, joints):
        raise InputError(
            problem,
            "correct the file: the links of an arm hang on one base, one joint above each; or name the arm in "
            "chain: or joints: of the case, and what does not concern it is not read",
            file=description.file,
            where=f"line {joint.line}, joint {joint.name}",
        )
    tops = ([*description.upwards(joint.child)][-1].parent for joint in joints)
    roots = dict.fromkeys([*bases, *tops])
    if len(roots) > 1:
        raise InputError(
            f"has several bases: {', '.join(roots)}",
            "name the arm in chain: or joints: of the case, and what does not concern it is not read",
            file=description.file,
        )


# --- bodies that an MJCF file weighs by their shapes


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
    # MJCF may give a shape its mass, else it has a density
    mass = shape.density * volume if shape.mass is None else shape.mass
    return shape.place.act(make(float(mass), *shape.size))


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
            # a joint turns about its anchor: there and, behind the joint, back
            place = place * joint.place * pin.SE3(np.eye(3), joint.anchor)
            if joint.name in joints:
                body, place = _add_joint(model, joint, body, place), pin.SE3.Identity()
            # a joint that is locked elsewhere than at zero moves what it carries once
            elif joint.kind in SINGLE and positions.get(joint.name):
                at = positions[joint.name]
                place = place * joint_motion(joint.kind, joint.axis, at)
            place = place * pin.SE3(np.eye(3), -joint.anchor)
        link = description.by_name[name]
        if (own := link.inertial) is not None:
            inertia = pin.Inertia(own.mass, own.com, own.moments)
            model.appendBodyToJoint(body, inertia, place)
        # the base has no body: what is fixed to it carries nothing that moves
        elif body and link.drawn and description.form == "MJCF":
            for shape in link.shapes:
                model.appendBodyToJoint(body, _weighed(shape), place)
        # links between several joints of one body are in no file
        if link.line:
            model.addFrame(pin.Frame(link.name, body, place, pin.FrameType.BODY), False)
        # reversed onto the stack: the first joint is taken first
        for below in reversed(description.below(name)):
            waiting.append((below, below.child, body, place))
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    return model


def joint_motion(kind: str, axis: np.ndarray, position: float) -> pin.SE3:
    """Motion of what a joint of a kind carries, along an axis of any length, (3,), to a position [rad or m]."""
    moved = axis / np.linalg.norm(axis) * position
    if kind == "prismatic":
        return pin.SE3(np.eye(3), moved)
    return pin.SE3(pin.exp3(moved), np.zeros(3))


def _add_joint(model: pin.Model, joint: Joint, body: int, place: pin.SE3) -> int:
    """Add a joint that moves; the number of the body that it carries."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    aligned = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
    free = pin.JointModelRevoluteUnaligned
    if joint.kind == "prismatic":
        aligned = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
        free = pin.JointModelPrismaticUnaligned
    # axes along x, y or z have joints of their own, which compute faster
    motion = aligned[axis.argmax()]() if axis.max() == 1.0 else free(axis)
    lower, upper = joint.lower or 0.0, joint.upper or 0.0
    # a range without width means none, whatever it was meant for
    if joint.turns_freely or lower >= upper:
        lower, upper = -np.inf, np.inf
    bounds = np.array([joint.effort or 0.0, joint.velocity or 0.0, lower, upper])
    return int(model.addJoint(body, motion, place, joint.name, *bounds[:, None]))


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
    # of all moments that links share, those on links of the most different masses
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
        # a continuous joint without <limit> is as it should be
        free = joint.turns_freely and len(lacking) == 2
        if joint.name in joints and lacking and not free:
            notes.append(
                f"{description.file}, joint {joint.name}: <limit> does not say {' and '.join(lacking)}: none is known"
            )
    return notes


# Joints of a robot file beside the arm's: where they are locked, and those that follow a joint of the arm.


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
    # a named arm's own joints move, and a name that is none is a slip
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
        # through chains of followers to the joint that moves at last
        rule = _chain_of_masters(name, single)
        position = rule.multiplier * float(given.get(rule.master, 0.0)) + rule.offset
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
    # at most once through all joints: a chain may close on itself
    for _ in single:
        joint = single.get(last)
        if joint is None or joint.mimic is None:
            break
        # q = m_1 (m_2 q_last + o_2) + o_1: offsets go through what is nearer
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
    # a model in which followers move too: its mass matrix has what they carry
    model = arm_model(path, (*joints, *followers), np.zeros(3), positions)
    posture = pin.neutral(model)
    for name in followers:
        posture[model.joints[model.getJointId(name)].idx_q] = positions[name]
    mass = pin.crba(model, model.createData(), posture)
    mass = np.triu(mass) + np.triu(mass, 1).T
    column = {name: model.joints[model.getJointId(name)].idx_v for name in model.names}
    for name, rule in followers.items():
        own, master = column[name], column[rule.master]
        # energy of both at one speed: m^2 M_ff + 2 m M_fj beside M_jj
        m = rule.multiplier
        added[list(joints).index(rule.master)] += (
            m**2 * mass[own, own] + 2 * m * mass[own, master]
        )
    # a follower that mostly moves against its master may seem to take inertia off
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
            f"{tree.file}: locked at zero: {shortened(silent)}; if one stood elsewhere, say so in locked: of "
            "the case"
        )
    if fixed:
        notes.append(
            f"{tree.file}: fixed as the file draws it, for it has several degrees of freedom: "
            f"{shortened(fixed)}"
        )
    return notes


# --- what an MJCF file says beside bodies and joints


def left_out(description: Description, joints: Sequence[str]) -> tuple[str, ...]:
    """What acts on an arm by its MJCF file and is not simulated, and the gains of its actuators, a sentence each."""
    path = description.file
    notes = [said for name, said in description.unread if not name or name in joints]
    for link in description.links:
        if link.drawn and link.inertial is None and description.is_moved(link.name):
            notes.append(
                f"body {link.name} has no <inertial> and is weighed by its shapes; give it one"
            )
    gains = [description.single[name].gains or (0.0, 0.0) for name in joints]
    if np.any(gains):
        kp, kd = (", ".join(f"{x:g}" for x in own) for own in zip(*gains, strict=True))
        notes.append(
            f"its actuators hold positions; as the controller: of a case, kp: [{kp}], kd: [{kd}] at the rate of the "
            "simulation"
        )
    return tuple(f"{path}: {note}" for note in notes)
