"""The identified arm as files that other tools read: a URDF of consistent bodies, a data sheet, effects.

Any ten parameters per link need a URDF, which ``link_inertia`` of the catalogue (mass and centre of mass alone) cannot
replace; rotor inertia, Coulomb and viscous friction go into the data sheet; offsets, a Stribeck term, and rotor and
friction of coupled motors are effects. How it builds up stands beside them.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.dynamics.plain_urdf import moving_links, numbers, plain_urdf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import read_case_file
from gapscope.arm.io.case_paths import moved
from gapscope.arm.io.write_case import nominal_section
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.ident.identification import Identification

UNNOTICED = 1e-9
"""Offsets and friction below this are not written [N m]."""
COUPLED = {
    "I": "motor_rotor",
    "b": "motor_damping",
    "c": "motor_friction",
    "d": "motor_breakaway",
    "s": "motor_saturating",
}
"""Quantity of a coupled motor by the symbol of its column."""


def presliding(result: Identification) -> np.ndarray:
    """Distance over which the dry friction of each joint builds up, and of the motor of its number [rad], (n,)."""
    distances = result.choice.law.presliding or result.case.arm.presliding
    n, arm = result.case.arm.n_joints, result.case.arm
    size = arm.per_radian if result.choice.law.presliding else 1.0
    return np.array(distances)[:n] * size


def identified_bodies(result: Identification) -> RigidBody:
    """The identified bodies: base parameters describe none, the consistent ones do."""
    body = result.columns.body
    links = result.physical.value[: 10 * result.case.arm.n_joints]
    return body.changed((links - body.inertial_parameters()).reshape(-1, 10))


def urdf_text(arm: NominalArm, body: RigidBody) -> str:
    """URDF of bodies of an arm: the nominal arm's kinematics and limits, one link per joint, no shapes.

    Frames and axes are those of the nominal arm's joints; inertial frames lie along the principal axes.
    """
    links = moving_links(body)
    root = ET.fromstring(plain_urdf(links))
    root.set("name", arm.name)
    # principal moments in full precision
    for link, element in zip(links, root.findall("link")[1:], strict=True):
        inertia = element.find("inertial/inertia")
        assert inertia is not None
        for key, value in zip(("ixx", "iyy", "izz"), link.moments, strict=True):
            inertia.set(key, repr(float(value)))
    # limits of the nominal arm
    speed, effort = body.velocity_limits(), body.effort_limits()
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        j = arm.joints.index(joint.get("name", ""))
        if speed[j] > 0:
            limit.set("velocity", numbers(speed[j : j + 1]))
        if effort[j] > 0:
            limit.set("effort", numbers(effort[j : j + 1]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def with_sheet(result: Identification) -> NominalArm:
    """The nominal arm with rotor inertia [kg m^2], Coulomb [N m] and viscous friction [N m s/rad] as identified."""
    arm, named = result.case.arm, _named(result)

    def joints(symbol: str) -> np.ndarray:
        values = [named.get(f"{symbol}{j + 1}", 0.0) for j in range(arm.n_joints)]
        return np.array([round(max(value, 0.0), 9) for value in values])

    return replace(arm, armature=joints("I"), coulomb=joints("c"), viscous=joints("b"))


def sheet(result: Identification) -> dict[str, Any]:
    """The ``nominal:`` section of an identified arm."""
    return nominal_section(with_sheet(result))


def effects(result: Identification) -> tuple[AppliedEffect, ...]:
    """Offsets, Stribeck and saturating friction, rotors and friction of coupled motors as effects."""
    found = _of_coupled_motors(result)
    joints, offset = _noticed(result, "o")
    if joints:
        found.append(drives_with(joints, offset=offset))
    law = result.choice.law
    joints, drop = _noticed(result, "d")
    if joints and law.stribeck_speed is not None:
        velocity = law.stribeck_speed * _sizes(result, joints)
        # the solver's bound at zero holds to its tolerance only
        drop = np.maximum(drop, 0.0)
        found.append(drives_with(joints, breakaway=drop, breakaway_speed=velocity))
    joints, level = _noticed(result, "s")
    if joints and law.saturation_speeds is not None:
        fastest = np.array(law.saturation_speeds)[np.array(joints) - 1]
        velocity = fastest * _sizes(result, joints)
        level = np.maximum(level, 0.0)
        found.append(drives_with(joints, saturating=level, saturating_speed=velocity))
    return tuple(found)


def _sizes(result: Identification, joints: tuple[int, ...]) -> np.ndarray:
    """What counts as a radian of some joints, in which the friction law has its speeds."""
    return result.case.arm.per_radian[np.array(joints) - 1]


def _of_coupled_motors(result: Identification) -> list[AppliedEffect]:
    """Rotor, viscous and dry friction of each coupled motor, by the columns of its own."""
    named, law = _named(result), result.choice.law
    motors = [int(label.removesuffix("m")) for label in result.columns.coupled]
    first = len(result.case.arm.joints)
    found = []
    for symbol, quantity in COUPLED.items():
        for k, motor in enumerate(motors):
            value = named.get(f"{symbol}{motor}m", 0.0)
            # the solver's bound at zero holds to its tolerance only
            if value <= UNNOTICED:
                continue
            values = {quantity: np.array([value])}
            speed = f"{quantity}_speed"
            if symbol == "d":
                values[speed] = np.array([law.stribeck_speed])
            if symbol == "s" and law.saturation_speeds is not None:
                values[speed] = np.array([law.saturation_speeds[first + k]])
            found.append(drives_with((motor,), **values))
    return found


def _noticed(result: Identification, symbol: str) -> tuple[tuple[int, ...], np.ndarray]:
    """Joints, from 1, on which a parameter exceeds ``UNNOTICED``, and its values there."""
    named = _named(result)
    values = {
        j: named.get(f"{symbol}{j}", 0.0)
        for j in range(1, result.case.arm.n_joints + 1)
    }
    joints = tuple(j for j, value in values.items() if abs(value) > UNNOTICED)
    return joints, np.array([values[j] for j in joints])


def write_case_beside(arm: NominalArm, source: Path, path: Path, urdf: str) -> None:
    """Write a case like the one at ``source`` whose nominal arm is the identified one.

    Args:
        arm: the identified arm.
        source: the case file.
        path: the case file to write; the recordings stay where they are.
        urdf: name of the URDF beside it.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content = moved(read_case_file(source), source.parent, path.parent)
    # the URDF holds the arm's moving bodies alone
    for key in ("chain", "locked"):
        content.pop(key, None)
    content |= {
        "name": f"{content['name']} identified",
        "robot": urdf,
        "joints": list(arm.joints),
        "gravity": arm.gravity.tolist(),
        "nominal": nominal_section(arm),
    }
    with atomic_write(path) as aside:
        aside.write_text(
            yaml.safe_dump(
                content, sort_keys=False, default_flow_style=None, width=120
            ),
            encoding="utf-8",
        )


def _named(result: Identification) -> dict[str, float]:
    names = result.columns.names(result.choice.law)
    return dict(zip(names, result.physical.value.tolist(), strict=True))
