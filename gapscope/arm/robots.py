"""Nominal arms from a URDF file, or from a known name."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.data_sheet import UNITS, checked_sheet
from gapscope.arm.dynamics.robot_file import actuated_joints, mjcf_entries
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm

MODELS = Path(__file__).with_name("robot_models")
"""Models that come with the package."""


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

PER_JOINT = tuple(UNITS)
"""Entries of the data sheet with one value per joint."""


def load_nominal_arm(
    robot: str | Path,
    *,
    folder: Path | None = None,
    joints: Sequence[str] | None = None,
    gravity: Sequence[float] | None = None,
    sheet: Mapping[str, Any] | None = None,
    source: Path | None = None,
) -> NominalArm:
    """Nominal arm from a URDF and a data sheet.

    Args:
        robot: path of a URDF or MJCF file, relative to ``folder``, or one of ``KNOWN_ROBOTS``.
        folder: folder that a relative path starts from; the current one by default.
        joints: order of the joints; by default the URDF's actuated joints.
        gravity: [m/s^2] in the base frame, shape (3,); default that of an MJCF file, else
            (0, 0, -9.81).
        sheet: the data sheet, the ``nominal:`` section of a case: armature [kg m^2], coulomb [N m], viscous
            [N m s/rad], torque_limit [N m], encoder, encoder_step [rad]. If coulomb or viscous is absent, the
            URDF's ``<dynamics friction= damping=>`` is used, and zero if that is absent too; of an MJCF file the
            joints' ``armature``, ``frictionloss`` and ``damping``.
        source: the case file, for messages.

    Raises:
        InputError: no such robot or joint, or a data sheet that cannot be used.
    """
    urdf, default_joints = _locate(robot, folder or Path())
    available = actuated_joints(urdf)
    names = tuple(joints or default_joints or available)
    for name in names:
        if name not in available:
            raise InputError(
                f"{urdf} has no movable joint {name!r}; it has {', '.join(available)}",
                "correct joints:, or give the URDF of the recorded arm",
                file=source or urdf,
                where="field joints",
            )
    try:
        given = checked_sheet(
            sheet, len(names), "sheet" if source is None else "field nominal"
        )
    except InputError as error:
        raise (error if source is None else error.at(source)) from None
    values = {**mjcf_entries(urdf, names), **given}
    values.setdefault("viscous", _dynamics(urdf, names, "damping"))
    values.setdefault("coulomb", _dynamics(urdf, names, "friction"))
    if gravity is not None:
        values["gravity"] = np.asarray(gravity, dtype=float)
    return NominalArm(
        name=_robot_name(urdf),
        urdf=urdf,
        joints=names,
        friction_source=_friction_source(urdf, given, values),
        **values,
    )


def _friction_source(
    urdf: Path, sheet: Mapping[str, Any], values: Mapping[str, Any]
) -> str:
    """Where the friction of an arm comes from, in words; empty if it has none."""
    from_file = f"{urdf.name} <dynamics>"
    if ET.parse(urdf).getroot().tag == "mujoco":
        from_file = f"{urdf.name} frictionloss and damping"
    sources = {
        name: "data sheet" if name in sheet else from_file
        for name in ("coulomb", "viscous")
        if np.any(values[name])
    }
    if len(set(sources.values())) < 2:
        return "".join(set(sources.values()))
    return ", ".join(f"{name} from {source}" for name, source in sources.items())


def _locate(robot: str | Path, folder: Path) -> tuple[Path, tuple[str, ...] | None]:
    """Path of the URDF, and the arm's joints if the name is a known one."""
    path = folder / robot
    if path.is_file():
        return path, None
    known = KNOWN_ROBOTS.get(str(robot))
    if known is None:
        raise InputError(
            "no such URDF file",
            f"{nearest(str(robot), KNOWN_ROBOTS)}give a URDF, or one of the known robots {', '.join(KNOWN_ROBOTS)}",
            file=path,
        )
    package = find_spec("pybullet_data")
    if package is not None and package.submodule_search_locations:
        return Path(package.submodule_search_locations[0]) / known.urdf, known.joints
    if known.plain is not None:
        return known.plain, known.joints
    raise InputError(
        f"the model of {robot} comes with PyBullet",
        "pip install 'gapscope[pybullet]', or give a URDF file",
    )


def _robot_name(urdf: Path) -> str:
    root = ET.parse(urdf).getroot()
    return root.get("name") or root.get("model") or urdf.stem


def _dynamics(urdf: Path, joints: Sequence[str], attribute: str) -> np.ndarray:
    """One attribute of ``<dynamics>`` per joint, zero if the URDF does not give it, shape (n,)."""
    values = dict.fromkeys(joints, 0.0)
    for joint in ET.parse(urdf).getroot().iter("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and joint.get("name") in values:
            values[joint.get("name", "")] = float(dynamics.get(attribute, 0))
    return np.array(list(values.values()))
