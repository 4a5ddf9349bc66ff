"""The robot file behind a path, a known name or a case, without building the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.input_file import is_folder
from gapscope.arm.io.case_file import read_case_file
from gapscope.arm.io.case_paths import CasePaths
from gapscope.arm.known_robots import locate


@dataclass(frozen=True)
class RobotFile:
    """A robot file, and the case that names it.

    Attributes:
        path: URDF or MJCF file.
        case: the case file, or ``None``.
        gravity: that the case gives [m/s^2], or ``None``.
    """

    path: Path
    case: Path | None = None
    gravity: tuple[float, ...] | None = None


def find_robot(robot: str | Path) -> RobotFile:
    """The file of a robot: a URDF or MJCF file, a known name, a case folder or its case file.

    Raises:
        InputError: there is none.
    """
    path = Path(robot)
    if not (is_folder(path) or path.suffix in (".yaml", ".yml")):
        return RobotFile(locate(robot, Path())[0])
    file = path / "case.yaml" if is_folder(path) else path
    content = read_case_file(file)
    named = CasePaths(file, None).expand(content["robot"], "robot")
    found, _ = locate(named, file.parent)
    gravity = content.get("gravity")
    return RobotFile(found, file, None if gravity is None else tuple(gravity))
