"""All checks of a model file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gapscope.arm.dynamics.robot_file import build
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.model_audit.check_geometry import check_geometry
from gapscope.model_audit.check_inertials import check_inertials
from gapscope.model_audit.check_joints import check_joints
from gapscope.model_audit.check_products import check_products
from gapscope.model_audit.check_repeats import check_repeats
from gapscope.model_audit.description import Description
from gapscope.model_audit.find_robot import RobotFile, find_robot
from gapscope.model_audit.finding import Finding, worst_first
from gapscope.model_audit.geometry import Geometry, link_geometries
from gapscope.model_audit.read_mjcf import read_mjcf
from gapscope.model_audit.read_urdf import read_urdf
from gapscope.model_audit.shifted import check_shifted
from gapscope.model_audit.static_poses import StaticPoses, check_static, static_poses
from gapscope.model_audit.thresholds import (
    GRAVITY_TOLERANCE,
    LIGHT_SHARE,
    STANDARD_GRAVITY,
)
from gapscope.model_audit.xml_lines import read_xml


@dataclass(frozen=True)
class Audit:
    """What is odd about a model.

    Attributes:
        description: the file as it stands.
        geometries: size of each link with usable shapes.
        refused: why no arm can be built of it; empty if one can.
        findings: worst first.
        static: gravity torque against measured, or ``None`` without static poses.
    """

    description: Description
    geometries: dict[str, Geometry]
    refused: str
    findings: tuple[Finding, ...]
    static: StaticPoses | None = None


def audit_model(robot: str | Path, recording: Path | None = None) -> Audit:
    """Audit the file of a robot, and its gravity torque if there are static poses.

    Args:
        robot: URDF or MJCF file, known name, or case.
        recording: a recording of static poses, or a case of them.

    Raises:
        InputError: there is no such file, it is no XML of a robot, or the recording has no static poses.
    """
    source = find_robot(robot)
    description = read_description(source.path)
    geometries = link_geometries(description)
    refused = _refused(description)
    findings = [*description.unreadable]
    findings += check_description(description, geometries)
    findings += _gravity(source)
    if refused:
        findings.append(
            Finding(
                "impossible",
                "refused",
                "",
                0,
                refused,
                "a model that can be built",
                "put right what is named here first: no other command can use this file",
                1e4,
            )
        )
    static = None
    if recording is not None:
        static = static_poses(robot, recording)
        findings += check_static(static)
    return Audit(description, geometries, refused, worst_first(findings), static)


def read_description(path: Path) -> Description:
    """A URDF or MJCF file as it stands.

    Raises:
        InputError: it is neither.
    """
    root, lines = read_xml(path)
    if root.tag == "robot":
        return read_urdf(root, lines, path)
    if root.tag == "mujoco":
        return read_mjcf(root, lines, path)
    raise InputError(
        f"root element is <{root.tag}>, expected <robot> or <mujoco>",
        "give a URDF or MJCF file",
        file=path,
        where=f"line {lines[root]}",
    )


def check_description(
    description: Description, geometries: dict[str, Geometry]
) -> list[Finding]:
    """Findings of all checks of a file as it stands, in no order.

    Args:
        description: the file.
        geometries: size of each link with usable shapes, by name.
    """
    found = [
        *check_inertials(description, geometries),
        *check_geometry(description, geometries),
        *check_products(description, geometries),
        *check_shifted(description, geometries),
        *check_repeats(description),
        *check_joints(description),
        *_lost_meshes(description),
    ]
    return [_weighed(one, description) for one in found]


def _weighed(finding: Finding, description: Description) -> Finding:
    """A finding about a link that no joint moves, or that is very light, is a note: it hardly changes any torque."""
    tag, _, name = finding.place.partition(" ")
    names = {link.name for link in description.links}
    if tag != "link" or name not in names or finding.kind in ("loop", "no_mass"):
        return finding
    inertial = description.link(name).inertial
    least = LIGHT_SHARE * total_mass(description)
    light = inertial is not None and 0 < inertial.mass < least
    if not description.is_moved(name):
        why = "no joint moves it: of no effect on a fixed base"
    elif light:
        why = "a light link, of little effect"
    else:
        return finding
    return replace(finding, severity="note", found=f"{finding.found} ({why})")


def total_mass(description: Description) -> float:
    """Sum of the masses of all links [kg]."""
    return sum(link.inertial.mass for link in description.links if link.inertial)


def _refused(description: Description) -> str:
    """Why other commands refuse the file with all of its joints; empty if they take it."""
    joints = [joint.name for joint in description.moving]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is odd is found here
            build(description.file, joints)
    except GapscopeError as error:
        return str(error).split("\n")[0]
    return ""


def _lost_meshes(description: Description) -> Iterator[Finding]:
    """Meshes that were not found, all in one finding."""
    links = [link for link in description.links if link.lost]
    if not links:
        return
    names = list(dict.fromkeys(name for link in links for name in link.lost))
    yield Finding(
        "note",
        "lost_meshes",
        "",
        links[0].line,
        f"{len(names)} meshes of {len(links)} links are not found, {names[0]} the first",
        "meshes beside the file, or in a package folder above it",
        "put them there: without them sizes, densities and centres are judged by the joints' frames alone, or not",
        0.1,
    )


def _gravity(source: RobotFile) -> Iterator[Finding]:
    """Gravity of a case that is not that of the Earth."""
    if source.gravity is None:
        return
    size = float(np.linalg.norm(source.gravity))
    if abs(size - STANDARD_GRAVITY) > GRAVITY_TOLERANCE:
        yield Finding(
            "implausible",
            "gravity",
            "",
            0,
            f"gravity of {source.case} is {size:.4g} m/s^2",
            f"{STANDARD_GRAVITY:.4g} m/s^2 in the direction in which the base is mounted",
            "correct gravity: in the case; 0 is right only of an arm that lies on a table or floats",
            1.0,
        )
