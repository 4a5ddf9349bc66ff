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
        urdf: path of its model, with meshes, inside ``pybullet_data``.
        joints: the joints of the arm, all by default.
        plain: file of the same arm without meshes that comes with the package, if there is one.
    """

    urdf: str
    joints: tuple[str, ...] | None = None
    plain: Path | None = None


KNOWN_ROBOTS = {
    "kuka_iiwa": KnownRobot("kuka_iiwa/model.urdf", plain=MODELS / "kuka_iiwa.urdf"),
    "franka_panda": KnownRobot(
        "franka_panda/panda.urdf", tuple(f"panda_joint{j}" for j in range(1, 8))
    ),
    "xarm6": KnownRobot("xarm/xarm6_robot.urdf"),
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
    package = find_spec("pybullet_data")
    if package is not None and package.submodule_search_locations:
        return Path(package.submodule_search_locations[0]) / known.urdf, known.joints
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
