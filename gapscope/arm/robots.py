"""Robots by name or file, and the best published inertials of known ones."""

from __future__ import annotations

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import (
    SEVERAL,
    Description,
    Joint,
    Mimic,
    checked,
    inertial_faults,
    pybullet_data,
    read_description,
)
from gapscope.arm.dynamics.rigid_body import arm_model
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import check_file, is_file
from gapscope.arm.io.case_file import check
from gapscope.arm.nearest_name import nearest, shortened
from gapscope.arm.nominal import NominalArm, coupled

# Files of robots that are given by path, by a known name, or by a name of the package ``robot_descriptions``.


MODELS = Path(__file__).with_name("robot_models")
"""Models that come with the package."""
DESCRIPTION = re.compile(r"[a-z][a-z0-9_]*_description")
"""How names of ``robot_descriptions`` look."""


@dataclass(frozen=True)
class KnownRobot:
    """A robot that may be given by name.

    Attributes:
        source: where its inertials come from.
        urdf: path of its model, with meshes, inside ``pybullet_data``; empty if its inertials are placeholders.
        joints: the joints of the arm, all by default.
        plain: file of the same arm that comes with the package, if there is one.
        rotors: inertia of the rotors on each joint in simulated arms, if their bodies alone are too light for sampled
            control [kg m^2]; no part of the nominal arm of a diagnosis, which nobody measured it for.
    """

    source: str
    urdf: str = ""
    joints: tuple[str, ...] | None = None
    plain: Path | None = None
    rotors: tuple[float, ...] = ()


PANDA = tuple(f"panda_joint{j}" for j in range(1, 8))

KNOWN_ROBOTS = {
    "kuka_iiwa": KnownRobot(
        "round figures of github.com/rtkg/lbr_iiwa, not identified; no friction of the drives",
        "kuka_iiwa/model.urdf",
        plain=MODELS / "kuka_iiwa.urdf",
    ),
    "franka_panda": KnownRobot(
        "identified by Gaz and others 2019 [gaz2019], hand and fingers by Franka; no friction of the drives",
        joints=PANDA,
        plain=MODELS / "franka_panda.urdf",
        # as MuJoCo Menagerie's model of the arm has them
        rotors=(0.1,) * len(PANDA),
    ),
    "xarm6": KnownRobot(
        "UFACTORY's, of its xarm_ros; two of its bodies break the triangle inequality",
        "xarm/xarm6_robot.urdf",
    ),
}
"""Robots that may be given by name."""


def locate(robot: str | Path, folder: Path) -> tuple[Path, tuple[str, ...] | None]:
    """Path of the robot's file, and the arm's joints if the name is a known one.

    Raises:
        InputError: there is neither such a file nor such a robot, or the package that has it is not installed.
    """
    path = folder / robot
    # a file of that name goes before a known robot
    if is_file(path):
        return path, None
    known = KNOWN_ROBOTS.get(str(robot))
    if known is None:
        # only what looks like one of its names: it may be downloaded
        if DESCRIPTION.fullmatch(str(robot)):
            return described(str(robot)), None
        remedy = (
            f"{nearest(str(robot), KNOWN_ROBOTS)}give a URDF, or one of the known robots {', '.join(KNOWN_ROBOTS)}, or "
            "name of robot_descriptions such as ur5e_description"
        )
        check_file(path, remedy, absent="no such URDF file")
        return path, None
    # that of PyBullet comes with its meshes
    package = pybullet_data()
    if package is not None and known.urdf:
        return package / known.urdf, known.joints
    if known.plain is not None:
        return known.plain, known.joints
    raise InputError(
        f"the model of {robot} comes with PyBullet",
        "pip install 'gapscope[pybullet]', or give a URDF file",
    )


def described(name: str) -> Path:
    """File of a robot of the package ``robot_descriptions``, which downloads it when it is first asked for.

    Raises:
        InputError: the package is not installed, has no such robot, cannot download it, or has it as xacro only.
    """
    if find_spec("robot_descriptions") is None:
        raise InputError(
            f"no such file, and the package robot_descriptions, which may have {name}, is not installed",
            "pip install 'gapscope[robots]', or give a URDF file",
        )
    try:
        module = import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError:
        raise InputError(
            f"the package robot_descriptions has no {name}",
            "its list of robots is on github.com/robot-descriptions/robot_descriptions.py; or give a URDF file",
        ) from None
    # the module clones a repository when it is imported, which fails in as many ways as git and the network do
    except Exception as error:
        raise InputError(
            f"the package robot_descriptions cannot get {name} ({error})",
            "check git and the network, or give a URDF file",
        ) from None
    for kind in ("URDF_PATH", "MJCF_PATH"):
        if (path := getattr(module, kind, None)) is not None:
            return Path(path)
    raise InputError(
        f"{name} comes as xacro, from which a URDF is made first: {getattr(module, 'XACRO_PATH', 'its file')}",
        "pip install xacrodoc and expand it into a URDF file",
    )


# The nominal arm with the inertials of its URDF moved to other links.


def shifted_arm(arm: NominalArm, links: int, moved_only: bool = False) -> NominalArm:
    """The arm with each ``<inertial>`` moved ``links`` further among the links that have one, in file order.

    With ``moved_only`` among those of them that a joint moves. The new URDF lies in a temporary folder that lasts as
    long as the process, one for each text. An MJCF file is left as it is.
    """
    if links == 0 or (tree := read_description(arm.urdf, shapes=False)).form != "URDF":
        return arm
    root = shifted_root(tree, links, moved_only)
    folder = _folder(ET.tostring(root, encoding="unicode"), arm.urdf.name)
    return replace(arm, urdf=Path(folder.name) / arm.urdf.name)


def shifted_root(tree: Description, by: int, moved_only: bool) -> ET.Element:
    """A URDF with the ``<inertial>`` of each link that has one moved ``by`` such links further, in file order."""
    root = ET.fromstring(tree.file.read_bytes())
    moved = {joint.child for joint in tree.moving}
    links = [
        link
        for link in root.iter("link")
        if link.find("inertial") is not None
        and (not moved_only or link.get("name") in moved)
    ]
    # each link gives its own away before it gets another's
    inertials = [link.find("inertial") for link in links]
    # links in a ring: what falls off one end goes to the other
    givers = np.roll(np.arange(len(links)), by)
    for link, own, giver in zip(links, inertials, givers, strict=True):
        given = inertials[int(giver)]
        assert own is not None and given is not None
        link.remove(own)
        link.append(given)
    return root


@cache
def _folder(text: str, name: str) -> TemporaryDirectory[str]:
    """Temporary folder with a URDF; kept by its text, so that a thousand cases of one arm share it."""
    folder: TemporaryDirectory[str] = TemporaryDirectory(prefix="gapscope-")
    (Path(folder.name) / name).write_text(text, encoding="utf-8")
    return folder


# What of a file concerns its arm: joints that move, those beside it, and what it leaves open.


SAME_INERTIA = 4
"""So many links of different masses with the same moments of inertia have no moments of their own [1]."""


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
        f"links of {len(most)} different masses have the same moments of inertia, placeholders "
        "that are not the arm's: its torque cannot be judged by them; give its published inertials"
    )


def silent_limits(description: Description, joints: Collection[str]) -> Iterator[str]:
    """What the ``<limit>`` of joints of a URDF does not say, effort or velocity, a sentence for each joint."""
    for joint in description.joints if description.form == "URDF" else ():
        lacking = [key for key in ("effort", "velocity") if getattr(joint, key) is None]
        # a continuous joint without <limit> is as it should be
        free = joint.turns_freely and len(lacking) == 2
        if joint.name in joints and lacking and not free:
            said = f"<limit> does not say {' and '.join(lacking)}: none is known"
            yield f"joint {joint.name}: {said}"


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
    notes = [*_locked_at_zero(tree, joints, given)]
    notes += [
        f"{name} follows {rule.master}: its inertia counts there as armature, its change of gravity "
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


def _locked_at_zero(
    tree: Description, joints: Sequence[str], given: Mapping[str, float]
) -> Iterator[str]:
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
    if silent:
        yield f"locked at zero: {shortened(silent)}; if one stood elsewhere, say so in locked: of the case"
    if fixed:
        yield f"fixed as the file draws it, for it has several degrees of freedom: {shortened(fixed)}"


def left_out(description: Description, joints: Sequence[str]) -> Iterator[str]:
    """What acts on an arm by its MJCF file and is not simulated, and the gains of its actuators, a sentence each."""
    for name, said in description.unread:
        if not name or name in joints:
            yield said
    for link in description.links:
        if link.drawn and link.inertial is None and description.is_moved(link.name):
            yield f"body {link.name} has no <inertial> and is weighed by its shapes; give it one"
    stated = [description.single[name].gains or (0.0, 0.0) for name in joints]
    # without the sign of a zero
    gains = np.array(stated) + 0.0
    if np.any(gains):
        kp, kd = (", ".join(f"{x:g}" for x in own) for own in zip(*gains, strict=True))
        yield (
            f"its actuators hold positions or speeds; as the controller: of a case, kp: [{kp}], kd: [{kd}] at the "
            "rate of the simulation"
        )


# Nominal arms from a URDF file, or from a known name.


FROM_FILE = {"armature": "armature", "coulomb": "friction", "viscous": "damping"}
"""Entries of the data sheet that the file of a robot may give, as its joints call them."""


def load_nominal_arm(
    robot: str | Path,
    *,
    folder: Path | None = None,
    joints: Sequence[str] | None = None,
    chain: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    sheet: Mapping[str, Any] | None = None,
    source: Path | None = None,
) -> NominalArm:
    """Nominal arm from a URDF and a data sheet.

    A ``ModelWarning`` names joints that count and are locked for lack of a better word, links beside the arm whose
    inertial no body can have, and what of an MJCF file is not read.

    Args:
        robot: path of a URDF or MJCF file, relative to ``folder``, one of ``gapscope.arm.robots.KNOWN_ROBOTS``,
            or a name of the package ``robot_descriptions``.
        folder: folder that a relative path starts from; the current one by default.
        joints: order of the joints; by default those of ``chain``, else the file's movable joints that follow no other.
        chain: base and tip link of an arm inside a larger tree.
        locked: positions of joints that are none of the arm's [rad or m]; zero by default.
        gravity: [m/s^2] in the base frame, shape (3,); default that of an MJCF file, else
            (0, 0, -9.81).
        sheet: the data sheet, the ``nominal:`` section of a case: armature [kg m^2], coulomb [N m], viscous
            [N m s/rad], torque_limit [N m], encoder, encoder_step [rad]; m, N and kg of sliding joints. If coulomb or
            viscous is absent, the URDF's ``<dynamics friction= damping=>`` is used, and zero if that is absent too; of
            an MJCF file the joints' ``armature``, ``frictionloss`` and ``damping``.
        source: the case file, for messages.

    Raises:
        InputError: no such robot, link or joint, or a data sheet that cannot be used.
    """
    choices = {"joints": joints, "chain": chain, "locked": locked, "gravity": gravity}
    for key, value in choices.items():
        if value is not None:
            check(value, source, key, key)
    urdf, default_joints = locate(robot, folder or Path())
    tree = read_description(urdf, shapes=False)
    # what is asked for, else what the name stands for, else all that moves
    found = tree.chain(*chain) if chain else default_joints or actuated_joints(tree)
    names = tuple(joints or found)
    if not names:
        raise InputError(
            "has no joint that moves", "give the URDF of an arm", file=tree.file
        )
    missing = [name for name in names if name not in tree.single]
    if missing:
        raise InputError(
            f"{tree.file} has no movable joint {missing[0]!r}; it has {', '.join(tree.single)}",
            "correct joints:, or give the URDF of the recorded arm",
            file=source or tree.file,
            where="field joints",
        )
    # without a choice of joints the whole file is the arm, and is checked
    if not (joints or chain or default_joints):
        checked(tree)
    # then what concerns these joints
    checked(tree, names)
    given = _checked_sheet(sheet, len(names), source)
    positions, reflected, assumed = lock(tree, names, locked or {})
    moved = tree.moved(names)
    notes = [
        f"{fault.where}: {fault.problem}; it does not move with the arm and is left out"
        for link, fault in inertial_faults(tree).items()
        if link not in moved
    ]
    # of a known robot all this is known, and would be said each time
    if default_joints is None:
        notes += (*assumed, *filter(None, [placeholder(tree, names)]))
        notes += silent_limits(tree, names)
    values: dict[str, Any] = {
        key: np.array([getattr(tree.single[name], entry) or 0.0 for name in names])
        for key, entry in FROM_FILE.items()
    }
    if tree.form == "MJCF":
        notes += left_out(tree, names)
        values |= {} if tree.gravity is None else {"gravity": tree.gravity}
    for note in notes:
        warnings.warn(f"{tree.file}: {note}", ModelWarning, stacklevel=2)
    # what is given goes before what the file says
    values |= given
    # a joint that follows the arm's adds its inertia to that of the rotor
    if reflected.any():
        values["armature"] = np.asarray(values["armature"], float) + reflected
    # gravity that is given goes before that of the file
    if gravity is not None:
        values["gravity"] = np.asarray(gravity, dtype=float)
    try:
        return NominalArm(
            name=tree.name,
            urdf=urdf,
            joints=names,
            locked=positions,
            sliding=tuple(tree.single[name].kind == "prismatic" for name in names),
            friction_source=_friction_source(tree, given, values),
            **values,
        )
    except InputError as error:
        # an error of the sheet is one of the case, not of the robot's file
        if error.where.removeprefix("nominal.") not in given:
            raise
        place = "sheet" if source is None else "field nominal"
        where = error.where.replace("nominal", place)
        raise InputError(
            error.problem, error.remedy, file=source, where=where
        ) from None


def _checked_sheet(
    sheet: Mapping[str, Any] | None, n_joints: int, source: Path | None
) -> dict[str, Any]:
    """The entries of a data sheet that say something, by the case schema; coupling as the matrix D, (n, n)."""
    given = sheet
    # null, and a step of zero, say nothing
    if isinstance(sheet, Mapping):
        given = {key: value for key, value in sheet.items() if value is not None}
        if given.get("encoder_step") == 0:
            del given["encoder_step"]
    prefix = "sheet" if source is None else "nominal"
    check(given, source, "nominal", prefix)
    found = dict(given or {})
    if "coupling" in found:
        try:
            found["coupling"] = coupled(
                np.eye(n_joints), found["coupling"], f"{prefix}.coupling"
            )
        except InputError as error:
            raise error.at(source) from None
    return found


def _friction_source(
    tree: Description, sheet: Mapping[str, Any], values: Mapping[str, Any]
) -> str:
    """Where the friction of an arm comes from, in words; empty if it has none."""
    words = "<dynamics>" if tree.form == "URDF" else "frictionloss and damping"
    sources = {
        name: "data sheet" if name in sheet else f"{tree.file.name} {words}"
        for name in ("coulomb", "viscous")
        if np.any(values[name])
    }
    # from one place: its name alone
    if len(set(sources.values())) < 2:
        return "".join(set(sources.values()))
    return ", ".join(f"{name} from {source}" for name, source in sources.items())
