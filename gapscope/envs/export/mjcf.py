"""A corrected arm as MJCF: bodies, their joints, shapes and motors; ``mjcf_drive`` says how the motors act."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_shapes import Shape
from gapscope.arm.dynamics.plain_urdf import Link, numbers, rotation
from gapscope.envs.export.heading import mesh_path
from gapscope.envs.export.mjcf_drive import (
    add_actuators,
    add_coupled_motors,
    add_encoders,
    add_friction_default,
    add_gears,
    add_motor,
    how_to_use,
    set_drive,
    set_values,
    time_step,
)
from gapscope.envs.export.plain_arm import PlainArm

MESHES = (".stl", ".obj", ".msh")
"""Endings of the meshes that MuJoCo reads."""
MOST_FACES = 200_000
"""MuJoCo reads no STL file with more."""
ROUNDING = 1e-9
"""Share by which a moment of inertia may exceed the sum of the others before it counts as odd."""
LEAST = 1e-12
"""Mass [kg] and moments of inertia [kg m^2] that MuJoCo gives a moving body that has none."""


def as_mjcf(
    arm: PlainArm, out: Path, relative: bool
) -> tuple[ET.Element, tuple[str, ...]]:
    """The arm as MJCF, and what else is left out.

    Collision shapes are in group 3, visual ones in group 2; links that are fixed to a body are sites. What an actuator
    is commanded is the recorded torque: clipped, delayed, lagged, scaled and offset as the drive does it. A joint with
    elasticity or free play has a second joint beside it, that of its motor. Sensors hold what the encoders read.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.
    """
    root = ET.Element("mujoco", model=arm.corrected.arm.name)
    root.append(ET.Comment(how_to_use(arm)))
    compiler = ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    notes = _bounds(compiler, arm)
    step = time_step(arm)
    ET.SubElement(
        root,
        "option",
        timestep=repr(step),
        gravity=f"0 0 {-arm.gravity!r}",
        integrator="Euler",
    )
    add_friction_default(root, step)
    assets, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    base = ET.SubElement(world, "body", name=arm.body_name(""))
    _place(base, np.zeros(3), arm.mount)
    bodies = {"": base}
    for link in arm.links:
        bodies[link.joint] = _add_body(bodies[link.parent], link, arm)
    for frame in arm.frames.values():
        if frame.name != arm.body_name(frame.joint):
            _place(
                ET.SubElement(bodies[frame.joint], "site", name=frame.name, group="4"),
                frame.position,
                frame.rotation,
            )
    for number, shape in enumerate(arm.shapes):
        if problem := _unreadable(shape):
            notes.append(f"a {shape.use} shape of link {shape.frame.name}: {problem}")
        else:
            _add_shape(
                bodies[shape.frame.joint],
                assets,
                shape,
                number,
                mesh_path_of(shape, out, relative),
            )
    _exclude_neighbours(root, arm)
    tendons = ET.SubElement(root, "tendon")
    add_gears(tendons, arm)
    add_coupled_motors(tendons, arm)
    notes += add_actuators(root, arm, step)
    add_encoders(root, arm)
    return root, tuple(dict.fromkeys(notes))


def mesh_path_of(shape: Shape, out: Path, relative: bool) -> str:
    """How the file names a shape's mesh; an empty string if it has none."""
    return "" if shape.mesh is None else mesh_path(shape.mesh, out, relative)


def _bounds(compiler: ET.Element, arm: PlainArm) -> list[str]:
    """Let MuJoCo correct bodies that it would refuse, with a note."""
    notes = []
    if any(link.mass < LEAST or link.moments.max() < LEAST for link in arm.links):
        compiler.set("boundmass", repr(LEAST))
        compiler.set("boundinertia", repr(LEAST))
    elif any(link.moments.min() < LEAST for link in arm.links):
        compiler.set("boundinertia", repr(LEAST))
    odd = [
        link.joint
        for link in arm.links
        if link.moments[2] * (1 - ROUNDING) > link.moments[0] + link.moments[1]
    ]
    if odd:
        compiler.set("balanceinertia", "true")
        notes.append(
            f"principal moments of what is moved by {', '.join(odd)}: one is above the sum of the others, and MuJoCo "
            "puts their mean in their place"
        )
    return notes


def _add_body(parent: ET.Element, link: Link, arm: PlainArm) -> ET.Element:
    """A moving body with its joint; beside it its motor, if there is a gear between."""
    body = ET.SubElement(parent, "body", name=arm.body_name(link.joint))
    _place(body, link.origin[0], rotation(link.origin))
    inertial = ET.SubElement(
        body,
        "inertial",
        mass=repr(link.mass),
        diaginertia=numbers(_within(link.moments)),
    )
    _place(inertial, link.inertial[0], rotation(link.inertial))
    drive = arm.drives[link.joint]
    kind = "hinge" if link.kind == "revolute" else "slide"
    joint = ET.SubElement(
        body, "joint", name=link.joint, type=kind, axis=numbers(link.axis)
    )
    if link.limits is not None:
        joint.set("range", numbers(np.array(link.limits)))
    rest = drive.rest if drive.stiffness else 0.0
    set_values(joint, stiffness=drive.stiffness, springref=rest)
    if drive.gear is None:
        set_drive(joint, drive)
    else:
        motor = add_motor(parent, link, drive)
        _place(motor, link.origin[0], rotation(link.origin))
    return body


def _within(moments: np.ndarray) -> np.ndarray:
    """Ascending principal moments [kg m^2], (3,), of which rounding does not raise the last above the others' sum."""
    low, middle, high = moments.tolist()
    return np.array(
        [
            low,
            middle,
            low + middle if 0 < high - low - middle <= ROUNDING * high else high,
        ]
    )


def _add_shape(
    body: ET.Element, assets: ET.Element, shape: Shape, number: int, mesh: str
) -> None:
    """A shape of a body, and the asset of its mesh."""
    geom = ET.SubElement(
        body, "geom", type=shape.kind, group="2" if shape.use == "visual" else "3"
    )
    _place(geom, shape.frame.position, shape.frame.rotation)
    if shape.use == "visual":
        geom.set("contype", "0")
        geom.set("conaffinity", "0")
        geom.set("mass", "0")
    if shape.colour is not None:
        geom.set("rgba", numbers(np.array(shape.colour)))
    if shape.kind != "mesh":
        sizes = {
            "box": [x / 2 for x in shape.size],
            "cylinder": [shape.size[0], shape.size[-1] / 2],
        }
        geom.set("size", numbers(np.array(sizes.get(shape.kind, shape.size))))
        return
    scale = numbers(np.array(shape.size))
    same = (x for x in assets if x.get("file") == mesh and x.get("scale") == scale)
    asset = next(same, None)
    if asset is None:
        name = f"{Path(mesh).stem}_{number}"
        asset = ET.SubElement(
            assets, "mesh", name=name, file=mesh, scale=scale, inertia="shell"
        )
    geom.set("mesh", asset.get("name", ""))


def _unreadable(shape: Shape) -> str:
    """Why MuJoCo cannot read a shape's mesh, or an empty string."""
    if shape.mesh is None:
        return ""
    if shape.mesh.suffix.lower() not in MESHES:
        return f"MuJoCo reads no {shape.mesh.suffix or 'such'} file ({shape.mesh.name})"
    if shape.mesh.suffix.lower() == ".stl":
        with shape.mesh.open("rb") as file:
            head = file.read(84)
        faces = int.from_bytes(head[80:84], "little")
        if len(head) < 84 or shape.mesh.stat().st_size != 84 + 50 * faces:
            return f"MuJoCo reads no STL file in text ({shape.mesh.name})"
        if faces > MOST_FACES:
            return f"MuJoCo reads no mesh with more than {MOST_FACES} faces ({shape.mesh.name})"
    return ""


def _exclude_neighbours(root: ET.Element, arm: PlainArm) -> None:
    """No contact between neighbours, whose shapes overlap at the joint."""
    contact = ET.SubElement(root, "contact")
    for link in arm.links:
        ET.SubElement(
            contact,
            "exclude",
            body1=arm.body_name(link.parent),
            body2=arm.body_name(link.joint),
        )


def _place(element: ET.Element, position: np.ndarray, turn: np.ndarray) -> None:
    """Pose of an element; MuJoCo writes a quaternion with its real part first."""
    x, y, z, w = Rotation.from_matrix(turn).as_quat().tolist()
    element.set("pos", numbers(position))
    element.set("quat", numbers(np.array([w, x, y, z])))
