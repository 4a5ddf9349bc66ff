"""The moving bodies of an arm as MJCF, from the same links as ``gapscope.arm.dynamics.plain_urdf``."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from gapscope.arm.dynamics.plain_urdf import Link, numbers


def plain_mjcf(links: tuple[Link, ...], gravity: np.ndarray, dt: float) -> str:
    """MJCF text of the bodies: no shapes, no contacts, no damping, semi-implicit Euler with steps of dt [s].

    A diverging arm is not reset to its start.
    Masses and principal moments are written as 1, since a reader may refuse those that it finds odd; the engine sets
    ``Link.mass`` and ``Link.moments`` after loading. Joints are named as the links', bodies are not.
    """
    root = ET.Element("mujoco", model="arm")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(
        root, "option", timestep=repr(dt), integrator="Euler", gravity=numbers(gravity)
    )
    ET.SubElement(
        option, "flag", contact="disable", eulerdamp="disable", autoreset="disable"
    )
    bodies = {"": ET.SubElement(root, "worldbody")}
    for link in links:
        body = ET.SubElement(bodies[link.parent], "body")
        bodies[link.joint] = body
        _place(body, link.origin)
        inertial = ET.SubElement(body, "inertial", mass="1", diaginertia="1 1 1")
        _place(inertial, link.inertial)
        kind = "hinge" if link.kind == "revolute" else "slide"
        joint = ET.SubElement(
            body, "joint", name=link.joint, type=kind, axis=numbers(link.axis)
        )
        if link.limits is not None:
            joint.set("range", numbers(np.array(link.limits)))
            joint.set("solreflimit", f"{4 * dt!r} 1")
    return ET.tostring(root, encoding="unicode")


def _place(element: ET.Element, frame: tuple[np.ndarray, np.ndarray]) -> None:
    element.set("pos", numbers(frame[0]))
    element.set("quat", numbers(quaternion(frame)))


def quaternion(frame: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Orientation (w, x, y, z) [1] of a pose (xyz [m], roll-pitch-yaw [rad]), shape (4,), by half angles.

    ``pin.Quaternion`` of pinocchio 4.1 loses 80 bytes each time, which scattered over the heap cost 10 kB per arm.
    """
    half = 0.5 * np.asarray(frame[1])
    (sr, sp, sy), (cr, cp, cy) = np.sin(half), np.cos(half)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
