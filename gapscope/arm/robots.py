"""Nominal arms from a URDF file, or from a known name."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.data_sheet import checked_sheet
from gapscope.arm.dynamics.mjcf import numbers
from gapscope.arm.dynamics.robot_file import (
    actuated_joints,
    impossible_links,
    mjcf_entries,
    placeholder,
    silent_limits,
    tree_of,
)
from gapscope.arm.dynamics.tree.kinematic_tree import KinematicTree
from gapscope.arm.dynamics.tree.locked_joints import lock
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.known_robots import locate
from gapscope.arm.nominal import SHEET_UNITS, NominalArm

PER_JOINT = tuple(SHEET_UNITS)
"""Entries of the data sheet with one value per joint."""


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
        robot: path of a URDF or MJCF file, relative to ``folder``, one of ``gapscope.arm.known_robots.KNOWN_ROBOTS``,
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
    tree = tree_of(urdf)
    names = tuple(joints or _default_joints(tree, chain, default_joints))
    _check_joints(names, tree, source)
    try:
        given = checked_sheet(
            sheet, len(names), "sheet" if source is None else "field nominal"
        )
    except InputError as error:
        raise (error if source is None else error.at(source)) from None
    others = lock(tree, names, locked or {})
    notes = [_left_out(fault) for fault in impossible_links(urdf, names)]
    notes += others.notes if default_joints is None else ()
    if default_joints is None:
        notes += filter(None, [placeholder(urdf, names)])
        notes += [
            f"{urdf}, joint {name}: <limit> does not say {' and '.join(lacking)}: none is known"
            for name, lacking in silent_limits(urdf, names).items()
        ]
    for note in notes:
        warnings.warn(note, ModelWarning, stacklevel=2)
    values = {**mjcf_entries(urdf, names), **given}
    values.setdefault("viscous", _dynamics(urdf, names, "damping"))
    values.setdefault("coulomb", _dynamics(urdf, names, "friction"))
    if others.armature.any():
        own = np.asarray(values.get("armature", np.zeros(len(names))), dtype=float)
        values["armature"] = own + others.armature
    if gravity is not None:
        values["gravity"] = np.asarray(gravity, dtype=float)
    return NominalArm(
        name=_robot_name(urdf),
        urdf=urdf,
        joints=names,
        locked=others.positions,
        sliding=tuple(tree.single[name].kind == "prismatic" for name in names),
        friction_source=_friction_source(urdf, given, values),
        **values,
    )


def _default_joints(
    tree: KinematicTree, chain: Sequence[str] | None, known: Sequence[str] | None
) -> Sequence[str]:
    """Joints of an arm of which they are not named: those of the chain, of the known robot, or all."""
    if chain:
        return tree.chain(*chain)
    return known or actuated_joints(tree.path)


def _check_joints(
    names: Sequence[str], tree: KinematicTree, source: Path | None
) -> None:
    """Check that there are joints, and that the file has them."""
    if not names:
        raise InputError(
            "has no joint that moves", "give the URDF of an arm", file=tree.path
        )
    for name in names:
        if name not in tree.single:
            raise InputError(
                f"{tree.path} has no movable joint {name!r}; it has {', '.join(tree.single)}",
                "correct joints:, or give the URDF of the recorded arm",
                file=source or tree.path,
                where="field joints",
            )


def _left_out(fault: InputError) -> str:
    """A note on an inertial that no body can have, of a link that does not move with the arm."""
    return f"{fault.file}, {fault.where}: {fault.problem}; it does not move with the arm and is left out"


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


def _robot_name(urdf: Path) -> str:
    root = ET.parse(urdf).getroot()
    return root.get("name") or root.get("model") or urdf.stem


def _dynamics(urdf: Path, joints: Sequence[str], attribute: str) -> np.ndarray:
    """One attribute of ``<dynamics>`` per joint, zero if the URDF does not give it, shape (n,)."""
    values = dict.fromkeys(joints, 0.0)
    for joint in ET.parse(urdf).getroot().iter("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and joint.get("name") in values:
            name, text = joint.get("name", ""), dynamics.get(attribute, "0")
            place = f"joint {name}, <dynamics {attribute}>"
            values[name] = float(numbers(text, 1, urdf, place)[0])
    return np.array(list(values.values()))
