"""Files of robots that are given by path, by a known name, or by a name of the package ``robot_descriptions``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import check_file, is_file
from gapscope.arm.nearest_name import nearest

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


KNOWN_ROBOTS = {
    "kuka_iiwa": KnownRobot(
        "round figures of github.com/rtkg/lbr_iiwa, not identified; no friction of the drives",
        "kuka_iiwa/model.urdf",
        plain=MODELS / "kuka_iiwa.urdf",
    ),
    "franka_panda": KnownRobot(
        "identified by Gaz and others 2019 [gaz2019], hand and fingers by Franka; no friction of the drives",
        joints=tuple(f"panda_joint{j}" for j in range(1, 8)),
        plain=MODELS / "franka_panda.urdf",
        # as MuJoCo Menagerie's model of the arm has them
        rotors=(0.1,) * 7,
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
    if is_file(path):
        return path, None
    known = KNOWN_ROBOTS.get(str(robot))
    if known is None:
        if DESCRIPTION.fullmatch(str(robot)):
            return described(str(robot)), None
        remedy = (
            f"{nearest(str(robot), KNOWN_ROBOTS)}give a URDF, or one of the known robots {', '.join(KNOWN_ROBOTS)}, or "
            "name of robot_descriptions such as ur5e_description"
        )
        check_file(path, remedy, absent="no such URDF file")
        return path, None
    package = pybullet_data()
    if package is not None and known.urdf:
        return package / known.urdf, known.joints
    if known.plain is not None:
        return known.plain, known.joints
    raise InputError(
        f"the model of {robot} comes with PyBullet",
        "pip install 'gapscope[pybullet]', or give a URDF file",
    )


def pybullet_data() -> Path | None:
    """Folder of the package of models that comes with PyBullet, or ``None``."""
    package = find_spec("pybullet_data")
    if package is None or not package.submodule_search_locations:
        return None
    return Path(package.submodule_search_locations[0])


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
