"""A URDF of nothing but the arm's moving bodies, for engines that read URDF files in ways of their own.

Engines give a link without an inertial 1 kg, recompute inertia from collision shapes, zero inertia that breaks the
triangle inequality and lose the mass of fixed links. What is written here leaves them no room: one link per joint,
fixed and locked parts merged into it, inertial frames along the principal axes, no shapes, no damping.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jinja2
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from gapscope.arm.display import figures
from gapscope.arm.dynamics.rigid_body import UNLIMITED, RigidBody
from gapscope.arm.errors import InputError

POSTURES = 12
"""Postures that stand for all of an arm's where its inertia is looked at."""


Place = pin.SE3
"""Place of one frame in another: a translation [m] and a rotation."""


@dataclass(frozen=True)
class Link:
    """A moving body of an arm.

    Attributes:
        joint: name of the joint that moves it.
        parent: name of the joint that moves its parent, or an empty string for the base.
        kind: ``revolute`` or ``prismatic``.
        origin: place of the joint in the parent's frame.
        axis: unit axis in the joint's frame, shape (3,).
        limits: lower and upper position limit [rad or m], or ``None``.
        mass: [kg].
        inertial: place of the centre of mass with the principal axes in the joint's frame.
        moments: principal moments of inertia about the centre of mass [kg m^2], shape (3,).
    """

    joint: str
    parent: str
    kind: str
    origin: pin.SE3
    axis: np.ndarray
    limits: tuple[float, float] | None
    mass: float
    inertial: pin.SE3
    moments: np.ndarray


def moving_links(body: RigidBody, *, movable: bool = True) -> tuple[Link, ...]:
    """The moving bodies of an arm, parents before children.

    Args:
        body: the arm.
        movable: whether a finite torque has to be able to move them; a picture does not need it.

    Raises:
        InputError: a body has a negative mass, or the mass matrix is not positive definite.
    """
    if movable:
        check_inertia(body)
    model, data = body.model, body.model.createData()
    # at zero, in each joint's own frame: its column there is the axis
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    links = []
    lower, upper = (limit[body.order] for limit in body.position_limits())
    for index in range(1, model.njoints):
        jacobian = pin.getJointJacobian(model, data, index, pin.LOCAL).reshape(6, -1)
        column = jacobian[:, model.joints[index].idx_v]
        # a turning joint has its axis in the angular part, a slide in the linear one
        turns = np.linalg.norm(column[3:]) > np.linalg.norm(column[:3])
        inertia = model.inertias[index]
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))  # a rotation, not a reflection
        low, high = float(lower[index - 1]), float(upper[index - 1])
        parent = int(model.parents[index])
        links.append(
            Link(
                joint=model.names[index],
                parent=model.names[parent] if parent else "",
                kind="revolute" if turns else "prismatic",
                origin=model.jointPlacements[index].copy(),
                axis=column[3:] if turns else column[:3],
                limits=(low, high) if np.isfinite([low, high]).all() else None,
                mass=float(inertia.mass),
                inertial=pin.SE3(axes, inertia.lever),
                moments=moments,
            )
        )
    return tuple(links)


@cache
def _template(name: str) -> jinja2.Template:
    """A template of this folder."""
    made = jinja2.Environment(
        # names of joints come from others
        autoescape=True,
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        undefined=jinja2.StrictUndefined,
    )
    own = (numbers, angles, quaternion, link_name)
    made.filters |= {function.__name__: function for function in own}
    return made.get_template(name)


def plain_urdf(
    links: tuple[Link, ...], name: str = "arm", *, exact: bool = False
) -> str:
    """URDF text of the bodies; the base has a mass of 1 kg, which a fixed base makes irrelevant.

    Unless they are ``exact``, principal moments are written as 1 kg m^2: a reader that corrects moments which break the
    triangle inequality cannot be given them by file, so the engine sets ``Link.moments`` after loading.
    """
    return _template("plain.urdf.j2").render(
        links=links,
        name=name,
        exact=exact,
        identity=pin.SE3.Identity(),
        unlimited=UNLIMITED,
    )


def exact_urdf(name: str, links: tuple[Link, ...]) -> ET.Element:
    """The same as an element with the arm's name, and with the principal moments in full precision."""
    text = plain_urdf(links, name, exact=True)
    # blanks of the template are no part of it
    return ET.fromstring(re.sub(r">\s+<", "><", text))


def check_inertia(body: RigidBody, at_fault: str = "") -> None:
    """Check that the bodies of an arm can be moved by a finite torque.

    Args:
        body: the arm.
        at_fault: effects that made the bodies what they are; the file by default.

    Raises:
        InputError: a body has a negative mass, or the mass matrix is not positive definite.
    """
    # a link without mass is fine as long as others make the mass matrix definite
    inertias = [body.model.inertias[int(link)] for link in body.links]
    bad = [
        i
        for i, x in enumerate(inertias)
        if x.mass < 0 or not np.isfinite(x.toDynamicParameters()).all()
    ]
    # the joint that most takes part in a motion without kinetic energy in the zero posture, or a negative one in others
    for k, q in enumerate(() if bad else body.postures(POSTURES + 1)):
        values, vectors = np.linalg.eigh(body.mass_matrix(q))
        least = 1e-9 if k == 0 else -1e-9
        if values[0] <= least * np.abs(values).max():
            bad.append(int(np.abs(vectors[:, 0]).argmax()))
            break
    if not bad:
        return
    joint = bad[0]
    moments = figures(np.linalg.eigvalsh(inertias[joint].inertia))
    raise InputError(
        f"the link moved by joint {joint + 1} ({body.joints[joint]}) has mass {inertias[joint].mass:.4g} kg and "
        f"principal moments of inertia {moments} kg m^2, which cannot be simulated",
        "give an increment that leaves the link's mass and inertia above zero"
        if at_fault
        else "give the link, or one that is fixed to it, an <inertial> with positive mass and inertia",
        file=None if at_fault else body.file,
        where=at_fault,
    )


def link_name(joint: str) -> str:
    """Name of the link that a joint moves in the plain URDF; the base for an empty string."""
    return f"{joint}_link" if joint else "base"


def angles(place: pin.SE3) -> np.ndarray:
    """Roll, pitch and yaw of a place [rad], shape (3,)."""
    return np.asarray(pin.rpy.matrixToRpy(place.rotation))


def set_origin(element: ET.Element, place: pin.SE3) -> None:
    """Give an element of a URDF an ``<origin>``, in place of the one that it may have."""
    origin = element.find("origin")
    origin = ET.SubElement(element, "origin") if origin is None else origin
    origin.set("xyz", numbers(place.translation))
    origin.set("rpy", numbers(angles(place)))


def set_limit(joint: ET.Element, effort: float, velocity: float) -> None:
    """Set limits of a joint of a URDF: effort [N m or N] and velocity [rad/s or m/s]; 0 or infinite if not known."""
    limits = {"effort": effort, "velocity": velocity}
    known = {name: x for name, x in limits.items() if 0 < x < np.inf}
    if not known:
        return
    limit = joint.find("limit")
    if limit is None:
        # a <limit> has to have both, and what is not known must not hold the joint
        limit = ET.SubElement(joint, "limit", effort="1e9", velocity="1e9")
    for name, value in known.items():
        limit.set(name, numbers([value]))


def numbers(values: Iterable[float]) -> str:
    """Numbers as an attribute of XML, without loss."""
    return " ".join(repr(float(value)) for value in values)


# The moving bodies of an arm as MJCF, from the same links as ``gapscope.arm.dynamics.plain_urdf``.


def plain_mjcf(links: tuple[Link, ...], gravity: np.ndarray, dt: float) -> str:
    """MJCF text of the bodies: no shapes, no contacts, no damping, semi-implicit Euler with steps of dt [s].

    A diverging arm is not reset to its start.
    Masses and principal moments are written as 1, since a reader may refuse those that it finds odd; the engine sets
    ``Link.mass`` and ``Link.moments`` after loading. Joints are named as the links', bodies are not.
    """
    return _template("plain.mjcf.j2").render(links=links, gravity=gravity, dt=dt)


def quaternion(place: pin.SE3) -> np.ndarray:
    """Orientation (w, x, y, z) [1] of a place, shape (4,).

    ``pin.Quaternion`` of pinocchio 4.1 loses 80 bytes each time, which scattered over the heap cost 10 kB per arm.
    """
    return np.roll(Rotation.from_matrix(place.rotation).as_quat(), 1)
