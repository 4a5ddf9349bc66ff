"""Robots by name or file, and the best published inertials of known ones."""

from __future__ import annotations

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gapscope.arm.dynamics.description import (
    Description,
    pybullet_data,
    read_description,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import (
    actuated_joints,
    checked,
    inertial_faults,
    left_out,
    lock,
    placeholder,
    silent_limits,
)
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import check_file, is_file
from gapscope.arm.io.case_file import check
from gapscope.arm.io.json_file import plain
from gapscope.arm.nearest_name import nearest
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
    # each link gives its own away before it gets another's
    inertials = [link.find("inertial") for link in links]
    # links in a ring: what falls off one end goes to the other
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
        f"{fault.file}, {fault.where}: {fault.problem}; it does not move with the arm and is left out"
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
        warnings.warn(note, ModelWarning, stacklevel=2)
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
    check(plain(given), source, "nominal", prefix)
    found = dict(given or {})
    if "coupling" in found:
        found["coupling"] = coupled(
            np.eye(n_joints), found["coupling"], f"{prefix}.coupling"
        )
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
