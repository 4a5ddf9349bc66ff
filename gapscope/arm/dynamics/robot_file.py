"""A robot from a URDF or an MJCF file, checked, as pinocchio has it."""

from __future__ import annotations

import io
import os
import re
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np
import pinocchio as pin

from gapscope.arm.beyond_any_arm import check_size
from gapscope.arm.dynamics import mjcf
from gapscope.arm.dynamics.inertials import inertial_faults
from gapscope.arm.dynamics.kinematic_tree import SINGLE, KinematicTree, read_tree
from gapscope.arm.dynamics.mjcf import (
    check_mjcf,
    check_references,
    left_out,
    name_bodies,
    numbers,
    position_gains,
    torque_limits,
)
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import read_bytes

UNEXPANDED = re.compile(r"<xacro:|\$\((find|arg|eval|env|optenv)\b|\$\{")
"""Marks of xacro in a file that was not expanded."""
_OF_JOINTS = (
    ("origin", "xyz", 3),
    ("origin", "rpy", 3),
    ("axis", "xyz", 3),
    ("dynamics", "damping", 1),
    ("dynamics", "friction", 1),
)
"""Elements of a URDF's joint, their attributes, and how many numbers each has; limits may be infinite."""
SAME_INERTIA = 4
"""So many links of different masses with the same moments of inertia have no moments of their own [1]."""
_NEEDED = ("origin", "parent", "child", "axis", "limit")
"""Elements of a URDF's joint that make its motion."""
_PARSER_ERROR = re.compile(r"Error: +(.*)")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def build(path: Path, joints: Collection[str] = ()) -> pin.Model:
    """The robot of a file, with its torque limits; joints of several degrees of freedom are fixed as the file draws it.

    Args:
        path: URDF or MJCF file.
        joints: those that move; inertials of bodies that they do not move may be impossible, and are left out then.

    Raises:
        InputError: there is no such file, it is no robot, or a body that moves is none that can be.
    """
    root = _arm_alone(path, joints)
    _check_places(root, path)
    try:
        with parser_output() as output:
            if root.tag == "robot":
                _plain(root, path, joints)
                return pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
            check_mjcf(root, path)
            model = _of_mjcf(root)
    except IndexError:
        raise InputError(
            "names a default class that it does not have",
            "correct class or childclass",
            file=path,
        ) from None
    except (ValueError, RuntimeError) as error:
        # what follows the first of them follows from it
        reason = next(iter(_PARSER_ERROR.findall(output.getvalue())), error)
        raise InputError(
            f"cannot be read as a robot ({reason})",
            "name the arm in chain: or joints: of the case, and what does not concern it is not read",
            file=path,
        ) from None
    for joint, limit in torque_limits(root, path).items():
        if model.existJointName(joint):
            model.effortLimit[model.joints[model.getJointId(joint)].idx_v] = limit
    return model


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
        InputError: the file lacks one of the joints, or has one with more than one degree of freedom.
    """
    full = build(path, joints)
    names = list(full.names)[1:]
    missing = [name for name in joints if name not in names]
    if missing:
        raise InputError(
            f"has no movable joint {', '.join(missing)}; it has {', '.join(names)}",
            "name the joints of the recording's columns in joints:, or give the URDF of the recorded arm",
            file=path,
        )
    others = [full.getJointId(name) for name in names if name not in joints]
    model = full
    if others:
        posture = pin.neutral(full)
        for name, position in (locked or {}).items():
            if not full.existJointName(name):
                continue
            posture[full.joints[full.getJointId(name)].idx_q] = position
        model = pin.buildReducedModel(full, others, posture)
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    model.armature = np.zeros(model.nv)
    _check_axes(model, path)
    if model.nq != model.nv or model.nv != len(joints):
        raise InputError("has joints with more than one degree of freedom", file=path)
    return model


def _check_axes(model: pin.Model, path: Path) -> None:
    """Check that each joint of an arm moves along or about some direction.

    Raises:
        InputError: the axis of one has none.
    """
    data = model.createData()
    columns = pin.computeJointJacobians(model, data, pin.neutral(model))
    still = ~(np.linalg.norm(columns, axis=0) > 0)
    if still.any():
        index = int(still.argmax())
        name = next(
            name
            for name, joint in zip(model.names, model.joints, strict=True)
            if joint.idx_v == index
        )
        raise InputError(
            "its axis has no direction, so that it moves nothing",
            'correct <axis xyz="...">, or axis of an MJCF file',
            file=path,
            where=f"joint {name}",
        )


def actuated_joints(path: Path) -> list[str]:
    """Names of the movable joints of a URDF or MJCF file in kinematic order, but for those that follow another."""
    follows = {joint.name for joint in tree_of(path).joints if joint.mimic is not None}
    return [name for name in list(build(path).names)[1:] if name not in follows]


def tree_of(path: Path) -> KinematicTree:
    """The joints of a URDF or MJCF file.

    Raises:
        InputError: there is no such file, or it is no robot.
    """
    return read_tree(read_root(path), path)


def impossible_links(path: Path, joints: Collection[str]) -> tuple[InputError, ...]:
    """What is wrong with inertials of links that none of an arm's joints moves.

    Raises:
        InputError: a link that moves is none that can be.
    """
    return tuple(_impossible_outside(read_root(path), path, joints).values())


def _impossible_outside(
    root: ET.Element, path: Path, joints: Collection[str]
) -> dict[str, InputError]:
    """What is wrong with inertials of links that none of these joints moves, by the name of the link.

    Raises:
        InputError: a link that moves is none that can be.
    """
    moved = read_tree(root, path).moved(joints)
    faults = inertial_faults(root, path)
    for link, fault in faults.items():
        if link in moved:
            raise fault
    return faults


def mjcf_entries(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Content of an MJCF file beyond the bodies, as fields of ``NominalArm``; nothing for a URDF.

    armature [kg m^2], coulomb [N m] (its ``frictionloss``) and viscous [N m s/rad] (its ``damping``), each (n,), and
    gravity [m/s^2], (3,), where it is given. A ``ModelWarning`` names what is left out.

    Raises:
        InputError: positions of one of the joints do not count from the pose that the file draws.
    """
    root = read_root(path)
    if root.tag == "robot":
        return {}
    check_references(root, path, joints)
    notes = (*left_out(root, path, joints), *position_gains(root, path, joints))
    for note in notes:
        warnings.warn(note, ModelWarning, stacklevel=3)
    model = build(path, joints)
    columns = [model.joints[model.getJointId(name)].idx_v for name in joints]
    values = {
        "armature": model.armature,
        "coulomb": model.upperDryFrictionLimit,
        "viscous": model.damping,
    }
    entries = {name: np.array(value)[columns] for name, value in values.items()}
    down = mjcf.gravity(root, path)
    return entries if down is None else {**entries, "gravity": down}


def read_root(path: Path) -> ET.Element:
    """Root element of a URDF, <robot>, or of an MJCF file, <mujoco>, whose bodies all have a name then.

    Raises:
        InputError: there is no such file, or it is no robot; a xacro file comes with the command that expands it.
    """
    content = read_bytes(path, "check the robot: entry of the case")
    text = COMMENT.sub("", content.decode("utf-8", "replace"))
    if path.suffix == ".xacro" or UNEXPANDED.search(text):
        raise InputError(
            "is xacro, from which a URDF is made first",
            f"xacro {path.name} > robot.urdf, with xacro of ROS or of pip install xacrodoc (xacrodoc {path.name} -o "
            "robot.urdf)",
            file=path,
        )
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise InputError(
            f"is not valid XML ({error})",
            "give a complete URDF or MJCF file; was it cut short?",
            file=path,
        ) from None
    if root.tag not in ("robot", "mujoco"):
        raise InputError(
            f"root element is <{root.tag}>, expected <robot> or <mujoco>",
            "give a URDF or MJCF file",
            file=path,
        )
    if root.tag == "mujoco":
        name_bodies(root)
    return root


def _arm_alone(path: Path, joints: Collection[str]) -> ET.Element:
    """Root element of a file without impossible inertials, and of a URDF without what does not concern the arm.

    Raises:
        InputError: there is no such file, or a body that moves is none that can be.
    """
    root = read_root(path)
    _drop_inertials(root, _impossible_outside(root, path, joints))
    links = read_tree(root, path).around(joints)
    if root.tag != "robot" or not links:
        return root
    ends = set(links)
    for joint in root.findall("joint"):
        child, parent = joint.find("child"), joint.find("parent")
        if child is None or child.get("link") not in links:
            root.remove(joint)
        elif parent is not None:
            ends.add(parent.get("link", ""))
    for link in root.findall("link"):
        if link.get("name") not in ends:
            root.remove(link)
    return root


def with_collision_shapes(path: Path, joints: Collection[str]) -> ET.Element:
    """Root element of a URDF with nothing but an arm and its collision shapes."""
    root = _arm_alone(path, joints)
    _plain(root, path, joints, shapes=True)
    return root


@contextmanager
def parser_output() -> Iterator[io.StringIO]:
    """Keep what libraries in C++ print from the terminal; it is in what is given once they are done."""
    kept = io.StringIO()
    # in memory, where the system has such files
    in_memory = getattr(os, "memfd_create", None)
    with (
        TemporaryFile()
        if in_memory is None
        else open(in_memory("parser"), "w+b") as file
    ):
        try:
            saved = os.dup(2)
        except OSError:  # there is no standard error
            yield kept
            return
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(file.fileno(), 2)
        try:
            yield kept
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            kept.write(file.read().decode("utf-8", "replace"))


def _check_places(root: ET.Element, path: Path) -> None:
    """Check the numbers of joints, and that none lies further from its parent than on any arm.

    The reader of URDF files says that something is wrong, not where.

    Raises:
        InputError: one does, or an attribute is not of as many numbers as it has to be.
    """
    held = [
        (joint, joint.find(tag), key, count)
        for joint in root.findall("joint")
        for tag, key, count in _OF_JOINTS
    ]
    held += [(body, body, "pos", 3) for body in root.iter("body")]
    for element, holder, key, count in held:
        text = None if holder is None else holder.get(key)
        if text is None:
            continue
        where = f"{element.tag} {element.get('name', '')}, {key}"
        values = numbers(text, count, path, where)
        if key in ("xyz", "pos"):
            check_size(values, "length", path, where)


def _drop_inertials(root: ET.Element, links: Collection[str]) -> None:
    """Leave out the inertials of some links or bodies."""
    for link in (*root.iter("link"), *root.iter("body")):
        inertial = link.find("inertial")
        if inertial is not None and link.get("name") in links:
            link.remove(inertial)


def _of_mjcf(root: ET.Element) -> pin.Model:
    """The model of an MJCF file whose bodies all have a name; pinocchio reads files only."""
    _tell_apart(root, "body")
    for body in root.iter("body"):
        for joint in body.findall("freejoint") + body.findall("joint"):
            if joint.tag == "freejoint" or joint.get("type") in ("free", "ball"):
                body.remove(joint)
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
        return pin.buildModelFromMJCF(str(file))


def placeholder(path: Path, joints: Collection[str]) -> str:
    """What says that the moments of inertia of an arm of a URDF stand in for unknown ones; empty if they do not."""
    root = read_root(path)
    moved = read_tree(root, path).moved(joints)
    masses: dict[tuple[tuple[str, str], ...], set[str]] = {}
    for link in root.findall("link"):
        inertia, mass = link.find("inertial/inertia"), link.find("inertial/mass")
        if link.get("name") in moved and inertia is not None and mass is not None:
            own = masses.setdefault(tuple(sorted(inertia.attrib.items())), set())
            own.add(mass.get("value", ""))
    most = max(masses.values(), key=len, default=set())
    if len(most) < SAME_INERTIA:
        return ""
    return (
        f"{path}: links of {len(most)} different masses have the same moments of inertia, placeholders that are not "
        "the arm's: its torque cannot be judged by them; give its published inertials"
    )


def silent_limits(path: Path, joints: Collection[str]) -> dict[str, list[str]]:
    """What the ``<limit>`` of joints of a URDF does not say, effort or velocity, by the name of the joint."""
    silent = {}
    for joint in read_root(path).findall("joint"):
        limit, turns = joint.find("limit"), joint.get("type") == "continuous"
        if joint.get("name") not in joints or (limit is None and turns):
            continue
        given = {} if limit is None else limit.attrib
        lacking = [key for key in ("effort", "velocity") if key not in given]
        if lacking:
            silent[joint.get("name", "")] = lacking
    return silent


def _plain(
    root: ET.Element, path: Path, joints: Collection[str], *, shapes: bool = False
) -> None:
    """Leave nothing in a URDF but the links and joints that a model needs, in the words that its reader insists on.

    Continuous joints are turned into revolute ones (pinocchio would give them two coordinates); floating and planar
    joints, and those of an unknown type, are fixed. A limit that is not given is none.
    """
    _tell_apart(root, "link")
    kept = {
        "link": ("inertial", "collision") if shapes else ("inertial",),
        "joint": _NEEDED,
    }
    for element in list(root):
        if element.tag not in kept:
            root.remove(element)
            continue
        for part in list(element):
            if part.tag not in kept[element.tag]:
                element.remove(part)
    # the reader insists on a name
    root.set("name", root.get("name") or "robot")
    for joint in root.iter("joint"):
        kind = joint.get("type")
        if kind not in SINGLE:
            joint.set("type", "fixed")
            for useless in joint.findall("limit"):
                joint.remove(useless)
            continue
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        name = joint.get("name", "")
        for key in ("lower", "upper", "effort", "velocity"):
            try:
                limit.set(key, str(float(limit.get(key, "0"))))
            except ValueError:
                if name in joints:
                    raise InputError(
                        f"expected a number, got {limit.get(key)!r}",
                        "correct the attribute, or leave it out",
                        file=path,
                        where=f"joint {name}, <limit {key}>",
                    ) from None
                limit.set(key, "0")
        if kind == "continuous":
            joint.set("type", "revolute")
            limit.set("lower", "-1e9")
            limit.set("upper", "1e9")


def _tell_apart(root: ET.Element, tag: str) -> None:
    """Rename links or bodies that are called like a joint: a frame of pinocchio is found by its name alone."""
    names = {joint.get("name") for joint in root.iter("joint")}
    for link in root.iter(tag):
        if link.get("name") in names:
            link.set("name", f"{tag} {link.get('name')}")
    for end in (*root.findall("joint/parent"), *root.findall("joint/child")):
        if end.get("link") in names:
            end.set("link", f"link {end.get('link')}")
