"""What a robot file says, as it stands: nothing is refused, merged or put right."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gapscope.model_audit.finding import Finding
from gapscope.model_audit.place import Place

MOVING = ("revolute", "prismatic")
"""Kinds of joints with one degree of freedom."""


@dataclass(frozen=True)
class Inertial:
    """Mass and moments of a link alone.

    Attributes:
        line: in the file.
        mass: [kg].
        com: centre of mass in the link's frame [m], shape (3,).
        moments: inertia about the centre of mass, in axes of the link's frame [kg m^2], shape (3, 3).
        diagonal: ixx, iyy, izz as the file has them [kg m^2], shape (3,).
    """

    line: int
    mass: float
    com: np.ndarray
    moments: np.ndarray
    diagonal: np.ndarray

    @property
    def is_body(self) -> bool:
        """Whether mass and moments are those of a body that can be: finite, mass above zero, moments not below."""
        finite = np.isfinite([self.mass, *self.com, *self.moments.flat]).all()
        return bool(
            finite and self.mass > 0 and np.linalg.eigvalsh(self.moments)[0] > 0
        )

    @property
    def variance(self) -> np.ndarray:
        """Second moment of the mass about its centre, per mass: (tr(I)/2 E - I) / m [m^2], shape (3, 3)."""
        return (np.eye(3) * np.trace(self.moments) / 2 - self.moments) / self.mass


@dataclass(frozen=True)
class Shape:
    """A shape of a link.

    Attributes:
        use: ``visual`` or ``collision``.
        kind: ``mesh``, ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``ellipsoid``.
        size: full edges [m]; radius and length of a cylinder [m] (of a capsule without its caps); radius [m]; scale of
            a mesh [1].
        place: of the shape in the link's frame.
        mesh: its file; ``None`` if it is no mesh, or was not found.
    """

    use: str
    kind: str
    size: tuple[float, ...]
    place: Place
    mesh: Path | None = None


@dataclass(frozen=True)
class Link:
    """A link of a URDF, a body of an MJCF file.

    Attributes:
        name, line: in the file.
        inertial: as the file has it, or ``None``.
        shapes: those whose size is known.
        lost: meshes that were not found, as the file names them.
    """

    name: str
    line: int
    inertial: Inertial | None
    shapes: tuple[Shape, ...] = ()
    lost: tuple[str, ...] = ()


@dataclass(frozen=True)
class Joint:
    """A joint; numbers that the file does not give are ``None``.

    Attributes:
        name, line: in the file.
        kind: ``revolute`` (continuous too), ``prismatic``, ``fixed`` or another word.
        parent, child: names of links.
        place: of the child in the parent's frame.
        axis: as written, shape (3,).
        turns_freely: whether it is declared to have no limits.
        lower, upper: position limits [rad or m].
        effort: [N m or N].
        velocity: [rad/s or m/s].
        damping: [N m s/rad], friction: [N m], armature: [kg m^2].
    """

    name: str
    line: int
    kind: str
    parent: str
    child: str
    place: Place
    axis: np.ndarray
    turns_freely: bool = False
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    damping: float | None = None
    friction: float | None = None
    armature: float | None = None


@dataclass(frozen=True)
class Description:
    """A robot file as it stands.

    Attributes:
        file: where it is.
        form: ``URDF`` or ``MJCF``.
        name: of the robot.
        links, joints: in the order of the file.
        unreadable: findings about what could not be read.
    """

    file: Path
    form: str
    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    unreadable: tuple[Finding, ...] = ()
    _by_name: dict[str, Link] = field(init=False, repr=False, compare=False)
    _above: dict[str, Joint] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Index links by name, and joints by the link below them."""
        object.__setattr__(self, "_by_name", {link.name: link for link in self.links})
        above = {joint.child: joint for joint in self.joints}
        object.__setattr__(self, "_above", above)

    def joint_above(self, link: str) -> Joint | None:
        """The joint that holds a link."""
        return self._above.get(link)

    def joints_below(self, link: str) -> list[Joint]:
        """Joints that a link holds, whose child is in the file."""
        return [j for j in self.joints if j.parent == link and j.child in self._by_name]

    def link(self, name: str) -> Link:
        """The link of a name."""
        return self._by_name[name]

    @property
    def moving(self) -> tuple[Joint, ...]:
        """Joints with one degree of freedom."""
        return tuple(joint for joint in self.joints if joint.kind in MOVING)

    def is_moved(self, link: str) -> bool:
        """Whether a moving joint lies between a link and the base."""
        name, seen = link, set()
        while (joint := self.joint_above(name)) is not None and name not in seen:
            if joint.kind != "fixed":
                return True
            seen.add(name)
            name = joint.parent
        return False

    def rigid_part(self, link: str) -> list[tuple[Link, Place]]:
        """A link and what fixed joints hold below it, with their places in its frame."""
        found, waiting = [], [(link, Place())]
        seen = set()
        while waiting:
            name, place = waiting.pop()
            if name in seen:  # a loop of fixed joints, which a broken file may have
                continue
            seen.add(name)
            found.append((self._by_name[name], place))
            for joint in self.joints_below(name):
                if joint.kind == "fixed":
                    waiting.append((joint.child, place * joint.place))
        return found

    def in_tree_order(self) -> list[Link]:
        """Links from the roots on, each before those that it holds and branch by branch."""
        roots = [link.name for link in self.links if link.name not in self._above]
        order: list[Link] = []
        waiting = roots[::-1]
        seen: set[str] = set()
        while waiting:
            name = waiting.pop()
            if name in seen:
                continue
            seen.add(name)
            order.append(self._by_name[name])
            waiting += [joint.child for joint in self.joints_below(name)][::-1]
        return order
