"""A robot's model as it is written: links, joints and shapes with their lines in the file; what can be found in it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from xml.parsers import expat

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.inertials import moments_matrix
from gapscope.arm.dynamics.link_shapes import (
    box_corners,
    cylinder_edges,
    directions,
    find_mesh,
    mesh_points,
)
from gapscope.arm.dynamics.mjcf import NAMELESS, Attributes, default_classes
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import is_file, is_folder, read_bytes
from gapscope.arm.io.case_file import read_case_file
from gapscope.arm.io.case_paths import CasePaths
from gapscope.arm.robots import locate

# One odd thing about a model.


SEVERITIES = ("impossible", "implausible", "missing", "note")
"""From worst: no body or joint is like this; hardly any is; something that a simulation needs is not given; to know."""


@dataclass(frozen=True)
class Finding:
    """One odd thing about a model.

    Attributes:
        severity: one of ``SEVERITIES``.
        kind: what is odd, one word with underscores.
        place: the link or joint, or an empty string for the whole file.
        line: line of the element in the file, 0 for the whole file.
        found: what the file says, with numbers and units.
        expected: what is usual or possible.
        remedy: what to do.
        size: how far off, from 0; orders findings of one severity.
    """

    severity: str
    kind: str
    place: str
    line: int
    found: str
    expected: str
    remedy: str
    size: float = 0.0


def worst_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """Findings by severity, then by size, then by line."""

    def key(one: Finding) -> tuple[int, float, int]:
        return SEVERITIES.index(one.severity), -one.size, one.line

    return tuple(sorted(findings, key=key))


# Place of one frame in another.


@dataclass(frozen=True)
class Place:
    """Place of a frame in another: p = R p' + x.

    Attributes:
        rotation: R [1], shape (3, 3).
        translation: x [m], shape (3,).
    """

    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __mul__(self, inner: Place) -> Place:
        """Place of a frame that is placed in this one."""
        shift = self.rotation @ inner.translation
        return Place(self.rotation @ inner.rotation, self.translation + shift)


def along(first: np.ndarray, second: np.ndarray) -> Place:
    """Place in the middle of two points [m] with the z axis from the first to the second."""
    direction = second - first
    length = np.linalg.norm(direction)
    z = direction / length if length else np.array([0.0, 0.0, 1.0])
    # any axis that is not along z will do for the others
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return Place(np.column_stack([x, np.cross(z, x), z]), (first + second) / 2)


# XML with the line on which each element begins.


Lines = dict[ET.Element, int]
"""Line, counted from 1, on which an element begins."""


def read_xml(path: Path) -> tuple[ET.Element, Lines]:
    """Root element of a file, and the lines of all elements.

    Raises:
        InputError: there is no such file, or it is not XML; names the line.
    """
    builder, lines = ET.TreeBuilder(), Lines()
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    content = read_bytes(path, "give a URDF or MJCF file")
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(
            f"is not valid XML ({expat.ErrorString(error.code)})",
            "give a complete URDF or MJCF file; was it cut short?",
            file=path,
            where=f"line {error.lineno}",
        ) from None
    return builder.close(), lines


# Numbers of XML attributes; what is none becomes a finding, and the default is used.


LARGEST = 1e50
"""Beyond it products of the numbers overflow; what means *unlimited* is less. What is below 1 over it is zero."""


class NumberReader:
    """Reads numbers of attributes and collects what is none.

    Args:
        lines: line of each element.

    Attributes:
        findings: what could not be read.
    """

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self.findings: list[Finding] = []

    def one(
        self,
        element: ET.Element | None,
        attribute: str,
        place: str,
        values: Mapping[str, str] | None = None,
    ) -> float | None:
        """One number, or ``None`` if it is not given or none; ``values`` replace the element's attributes."""
        if element is None:
            return None
        text = (element.attrib if values is None else values).get(attribute)
        if text is None:
            return None
        found = self._numbers(element, attribute, text, place)
        return float(found[0]) if len(found) else None

    def several(
        self,
        element: ET.Element | None,
        attribute: str,
        default: tuple[float, ...],
        place: str,
        values: Mapping[str, str] | None = None,
    ) -> np.ndarray:
        """As many numbers as the default has."""
        if element is None:
            return np.array(default)
        text = (element.attrib if values is None else values).get(attribute)
        if text is None:
            return np.array(default)
        found = self._numbers(element, attribute, text, place)
        if len(found) == len(default):
            return found
        if len(found):
            self.add(element, attribute, text, place, f"{len(default)} numbers")
        return np.array(default)

    def _numbers(
        self, element: ET.Element, attribute: str, text: str, place: str
    ) -> np.ndarray:
        try:
            found = np.array(text.split(), dtype=float)
        except ValueError:
            found = np.array([np.nan])
        if len(found) and (np.abs(found) < LARGEST).all():
            return np.where(np.abs(found) > 1 / LARGEST, found, 0.0)
        self.add(element, attribute, text, place, f"finite numbers below {LARGEST:g}")
        return np.empty(0)

    def add(
        self, element: ET.Element, attribute: str, text: str, place: str, wanted: str
    ) -> None:
        """Note that an attribute is not what is wanted."""
        self.findings.append(
            Finding(
                "impossible",
                "unreadable_number",
                place,
                self._lines.get(element, 0),
                f'<{element.tag} {attribute}="{text}">',
                wanted,
                "correct the attribute; the audit goes on with its default",
                size=1e6,
            )
        )


# What a robot file says, as it stands: nothing is refused, merged or put right.


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

    @classmethod
    def at(
        cls, pose: Place, line: int, mass: float | None, own: np.ndarray
    ) -> Inertial:
        """Of moments in axes of an inertial frame, (3, 3), which is placed in the link's; a mass not given is 0."""
        turned = pose.rotation @ own @ pose.rotation.T
        return cls(line, mass or 0.0, pose.translation, turned, np.diag(own))

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

    @property
    def where(self) -> tuple[str, int]:
        """Place and line of a finding about it: those of its inertial, if it has one."""
        return f"link {self.name}", self.inertial.line if self.inertial else self.line


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

    @property
    def where(self) -> tuple[str, int]:
        """Place and line of a finding about it."""
        return f"joint {self.name}", self.line


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

    @cached_property
    def _by_name(self) -> dict[str, Link]:
        return {link.name: link for link in self.links}

    @cached_property
    def _above(self) -> dict[str, Joint]:
        """Joints by the link below them."""
        return {joint.child: joint for joint in self.joints}

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


# How large a link is: the convex hulls of its shapes.


DIRECTIONS = 200
"""Points on a round surface; its hull is some 2 % smaller than the body."""


@dataclass(frozen=True)
class Geometry:
    """Size of a link, in its frame.

    Attributes:
        points: corners of the hull of all its shapes [m], shape (K, 3).
        volume: of its shapes' hulls, overlaps counted once at most [m^3].
        centre: of that volume [m], shape (3,).
        variance: second moment of that volume about its centre, per volume [m^2], shape (3, 3).
        edge: largest edge of the hull along the axes of the link [m].
    """

    points: np.ndarray
    volume: float
    centre: np.ndarray
    variance: np.ndarray
    edge: float


def link_geometries(description: Description) -> dict[str, Geometry]:
    """Size of each link that has usable shapes, by its name."""
    return {
        link.name: geometry
        for link in description.links
        if (geometry := link_geometry(description, link.name)) is not None
    }


def link_geometry(description: Description, link: str) -> Geometry | None:
    """Size of a link, with what is fixed to it and has no inertial of its own; ``None`` if a shape is lost, or all.

    Volume and variance are those of the collision shapes, or of the visual ones if there is no other; the hull is that
    of both.
    """
    shapes: list[tuple[Shape, np.ndarray]] = []
    for other, place in description.rigid_part(link):
        if other.name != link and other.inertial is not None:
            continue
        if other.lost:
            return None  # the shapes that are left may be a small part of the link
        for shape in other.shapes:
            corners = _corners(shape)
            if corners is None and shape.kind == "mesh":
                return None
            if corners is not None:
                pose = place * shape.place
                shapes.append((shape, corners @ pose.rotation.T + pose.translation))
    collisions = [points for shape, points in shapes if shape.use == "collision"]
    hulls = [
        hull
        for points in collisions or [p for _, p in shapes]
        if (hull := _hull(points))
    ]
    whole = _hull(np.vstack([points for _, points in shapes])) if shapes else None
    if not hulls or whole is None:
        return None
    volume, centre, variance = _together([_solid(hull) for hull in hulls])
    corners = whole.points[whole.vertices]
    edge = float(np.ptp(corners, axis=0).max())
    return Geometry(corners, min(volume, whole.volume), centre, variance, edge)


def distance_outside(geometry: Geometry, point: np.ndarray) -> float:
    """How far a point lies beyond the planes of the hull [m], at least; 0 inside."""
    equations = ConvexHull(geometry.points).equations
    return float(max(0.0, (equations[:, :3] @ point + equations[:, 3]).max()))


def _hull(points: np.ndarray) -> ConvexHull | None:
    """Convex hull of points; ``None`` if they are flat."""
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _solid(hull: ConvexHull) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume [m^3], centre [m] and second moment about the origin [m^5] of the body within a hull, by tetrahedra.

    With corners a, b, c and a centre o inside, each tetrahedron has the volume V = |det(a-o, b-o, c-o)| / 6 and, for
    its corners p_i, the second moment V/20 (sum p_i p_i^T + (sum p_i)(sum p_i)^T).
    """
    inside = hull.points[hull.vertices].mean(axis=0)
    corners = hull.points[hull.simplices]
    volumes = np.abs(np.linalg.det(corners - inside)) / 6
    sums = corners.sum(axis=1) + inside
    squares = np.einsum("tki,tkj->tij", corners, corners) + np.outer(inside, inside)
    moments = squares + np.einsum("ti,tj->tij", sums, sums)
    total = volumes.sum()
    centre = volumes @ sums / 4 / total
    return float(total), centre, np.einsum("t,tij->ij", volumes / 20, moments)


def _together(
    solids: list[tuple[float, np.ndarray, np.ndarray]],
) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume [m^3], centre [m] and variance [m^2] of several solids."""
    volume = sum(solid[0] for solid in solids)
    first = np.sum([v * centre for v, centre, _ in solids], axis=0)
    second = np.sum([moment for _, _, moment in solids], axis=0)
    centre = first / volume
    return volume, centre, second / volume - np.outer(centre, centre)


def _corners(shape: Shape) -> np.ndarray | None:
    """Points whose hull is the shape [m], shape (K, 3); ``None`` if it has no size."""
    if shape.kind == "mesh":
        return None if shape.mesh is None else _mesh(shape.mesh, shape.size)
    size = np.array(shape.size)
    if not (size > 0).all():
        return None
    if shape.kind == "box":
        return box_corners(size)
    if shape.kind == "cylinder":
        return cylinder_edges(size[0], size[1], 48)
    if shape.kind == "capsule":
        caps = directions(DIRECTIONS) * size[0]
        shift = np.array([0.0, 0.0, size[1] / 2])
        return np.vstack([caps + shift, caps - shift])
    return directions(DIRECTIONS) * size


@lru_cache(maxsize=256)
def _mesh(path: Path, scale: tuple[float, ...]) -> np.ndarray | None:
    """Corners of a mesh's hull [m]; ``None`` if it cannot be read."""
    points = mesh_points(path, scale)
    hull = None if points is None else _hull(points)
    return None if hull is None else hull.points[hull.vertices]


# A URDF as it stands.


MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ZERO = (0.0, 0.0, 0.0)
SIZES = {
    "box": (("size", ZERO),),
    "cylinder": (("radius", (0.0,)), ("length", (0.0,))),
    "sphere": (("radius", (0.0,)),),
}
"""Attributes of the primitives, with as many zeros as they have numbers."""


def read_urdf(root: ET.Element, lines: Lines, path: Path) -> Description:
    """A URDF as it stands."""
    reader = UrdfReader(lines, path)
    links = tuple(reader.link(element) for element in root.findall("link"))
    joints = tuple(reader.joint(element) for element in root.findall("joint"))
    return Description(
        path,
        "URDF",
        root.get("name") or path.stem,
        links,
        joints,
        tuple(reader.numbers.findings),
    )


class UrdfReader:
    """Reads links and joints of a URDF.

    Args:
        lines: line of each element.
        path: the file, from whose folder meshes are searched.
    """

    def __init__(self, lines: Lines, path: Path) -> None:
        self.numbers = NumberReader(lines)
        self._lines, self._path = lines, path

    def link(self, element: ET.Element) -> Link:
        """A link with its inertial and shapes."""
        name = element.get("name", "").strip()
        shapes, lost = [], []
        for drawn in (*element.findall("visual"), *element.findall("collision")):
            shape = self._shape(drawn, f"link {name}")
            if shape is not None and (shape.kind != "mesh" or shape.mesh):
                shapes.append(shape)
            elif shape is not None:
                mesh = drawn.find("geometry/mesh")
                assert mesh is not None  # its kind is mesh
                lost.append(mesh.get("filename", ""))
        inertial = element.find("inertial")
        return Link(
            name,
            self._lines[element],
            None if inertial is None else self._inertial(inertial, f"link {name}"),
            tuple(shapes),
            tuple(dict.fromkeys(lost)),
        )

    def joint(self, element: ET.Element) -> Joint:
        """A joint with its limits and dynamics."""
        name = element.get("name", "").strip()
        place, written = f"joint {name}", element.get("type", "")
        limit, dynamics = element.find("limit"), element.find("dynamics")
        axis = element.find("axis")
        parent, child = element.find("parent"), element.find("child")

        def limited(attribute: str) -> float | None:
            return self.numbers.one(limit, attribute, place)

        return Joint(
            name,
            self._lines[element],
            "revolute" if written == "continuous" else written,
            "" if parent is None else parent.get("link", "").strip(),
            "" if child is None else child.get("link", "").strip(),
            self._place(element.find("origin"), place),
            self.numbers.several(axis, "xyz", (1.0, 0.0, 0.0), place),
            written == "continuous",
            limited("lower"),
            limited("upper"),
            limited("effort"),
            limited("velocity"),
            self.numbers.one(dynamics, "damping", place),
            self.numbers.one(dynamics, "friction", place),
        )

    def _inertial(self, element: ET.Element, place: str) -> Inertial:
        mass, inertia = element.find("mass"), element.find("inertia")
        for tag, found in (("mass", mass), ("inertia", inertia)):
            if found is None:
                self.numbers.findings.append(
                    Finding(
                        "impossible",
                        "incomplete_inertial",
                        place,
                        self._lines[element],
                        f"<inertial> without <{tag}>",
                        "mass and inertia",
                        "give both, or leave <inertial> out of a link that has no mass",
                        size=1e6,
                    )
                )
        values = [self.numbers.one(inertia, name, place) or 0.0 for name in MOMENTS]
        own = moments_matrix(values)
        pose = self._place(element.find("origin"), place)
        mass_value = self.numbers.one(mass, "value", place)
        return Inertial.at(pose, self._lines[element], mass_value, own)

    def _place(self, origin: ET.Element | None, place: str) -> Place:
        xyz = self.numbers.several(origin, "xyz", ZERO, place)
        rpy = self.numbers.several(origin, "rpy", ZERO, place)
        return Place(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)

    def _shape(self, element: ET.Element, place: str) -> Shape | None:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            return None
        form, pose = geometry[0], self._place(element.find("origin"), place)
        if form.tag == "mesh":
            scale = self.numbers.several(form, "scale", (1.0, 1.0, 1.0), place)
            mesh = find_mesh(form.get("filename", ""), self._path)
            return Shape(element.tag, "mesh", tuple(scale), pose, mesh)
        if form.tag not in SIZES:
            return None
        size = [
            self.numbers.several(form, key, zero, place)
            for key, zero in SIZES[form.tag]
        ]
        return Shape(element.tag, form.tag, tuple(np.concatenate(size)), pose)


# An MJCF file as it stands; bodies whose inertial MuJoCo computes from shapes have none here.


KINDS = {"hinge": "revolute", "slide": "prismatic"}


def read_mjcf(root: ET.Element, lines: Lines, path: Path) -> Description:
    """An MJCF file as it stands; the world is the first link."""
    reader = MjcfReader(root, lines, path)
    for world in root.findall("worldbody"):
        reader.visit(world, "world", "main")
    return Description(
        path,
        "MJCF",
        root.get("model") or path.stem,
        (Link("world", 0, None), *reader.links),
        tuple(reader.joints),
        tuple(reader.numbers.findings),
    )


class MjcfReader:
    """Reads bodies, joints and shapes of an MJCF file, with what default classes give them.

    Args:
        root: of the file.
        lines: line of each element.
        path: the file, from whose folder meshes are searched.

    Attributes:
        links, joints: found so far, in the order of the file.
    """

    def __init__(self, root: ET.Element, lines: Lines, path: Path) -> None:
        self.links: list[Link] = []
        self.joints: list[Joint] = []
        self.numbers = NumberReader(lines)
        self._lines, self._classes = lines, default_classes(root)
        compiler = root.find("compiler")
        settings: Mapping[str, str] = {} if compiler is None else compiler.attrib
        degrees = settings.get("angle", "degree") == "degree"
        self._angle = np.pi / 180 if degrees else 1.0
        self._euler = settings.get("eulerseq", "xyz")
        folder = settings.get("meshdir") or settings.get("assetdir") or ""
        self._meshes = {
            mesh.get("name") or Path(mesh.get("file", "")).stem: mesh
            for mesh in root.findall("asset/mesh")
        }
        self._folder = path.parent / folder

    def visit(self, element: ET.Element, parent: str, inherited: str) -> None:
        """Read the bodies in an element."""
        for body in element.findall("body"):
            name = body.get("name") or f"{NAMELESS}_{len(self.links)}"
            below = body.get("childclass", inherited)
            self._body(body, name, parent, below)
            self.visit(body, name, below)

    def _body(self, body: ET.Element, name: str, parent: str, inherited: str) -> None:
        place = self._place(body, body.attrib, f"body {name}")
        joints = [x for x in body if x.tag in ("joint", "freejoint")]
        if not joints:
            fixed = Joint(
                f"{name} (fixed)",
                self._lines[body],
                "fixed",
                parent,
                name,
                place,
                np.zeros(3),
            )
            self.joints.append(fixed)
        # a body with several joints hangs on the last of them
        for element in joints[-1:]:
            self.joints.append(self._joint(element, name, parent, place, inherited))
        inertial = body.find("inertial")
        shapes, lost = [], []
        for geom in body.findall("geom"):
            shape, missing = self._shape(geom, f"body {name}", inherited)
            shapes += [shape] if shape else []
            lost += [missing] if missing else []
        self.links.append(
            Link(
                name,
                self._lines[body],
                None if inertial is None else self._inertial(inertial, f"body {name}"),
                tuple(shapes),
                tuple(dict.fromkeys(lost)),
            )
        )

    def _joint(
        self,
        element: ET.Element,
        body: str,
        parent: str,
        place: Place,
        inherited: str,
    ) -> Joint:
        values = self._values(element, inherited)
        name = element.get("name", f"joint of {body}")
        where = f"joint {name}"
        written = "free" if element.tag == "freejoint" else values.get("type", "hinge")
        kind = KINDS.get(written, written)
        limits = self.numbers.several(element, "range", (0.0, 0.0), where, values)
        given = "range" in values and values.get("limited") != "false"
        scale = self._angle if kind == "revolute" else 1.0
        force = self.numbers.several(
            element, "actuatorfrcrange", (0.0, 0.0), where, values
        )
        return Joint(
            name,
            self._lines[element],
            kind,
            parent,
            body,
            place,
            self.numbers.several(element, "axis", (0.0, 0.0, 1.0), where, values),
            not given,
            float(limits[0]) * scale if given else None,
            float(limits[1]) * scale if given else None,
            float(np.abs(force).min()) or None,
            None,
            self.numbers.one(element, "damping", where, values),
            self.numbers.one(element, "frictionloss", where, values),
            self.numbers.one(element, "armature", where, values),
        )

    def _inertial(self, element: ET.Element, place: str) -> Inertial:
        pose = self._place(element, element.attrib, place)
        if element.get("fullinertia") is not None:
            six = self.numbers.several(element, "fullinertia", (0.0,) * 6, place)
            xx, yy, zz, xy, xz, yz = six
            own = moments_matrix((xx, xy, xz, yy, yz, zz))
        else:
            own = np.diag(self.numbers.several(element, "diaginertia", ZERO, place))
        mass = self.numbers.one(element, "mass", place)
        return Inertial.at(pose, self._lines[element], mass, own)

    def _shape(
        self, element: ET.Element, place: str, inherited: str
    ) -> tuple[Shape | None, str]:
        """A shape, or the mesh that was not found."""
        values = self._values(element, inherited)
        kind = values.get("type", "mesh" if "mesh" in values else "sphere")
        # shapes that touch nothing are there to be seen
        seen = values.get("contype") == "0" and values.get("conaffinity") == "0"
        use = "visual" if seen else "collision"
        pose = self._place(element, values, place)
        if kind == "mesh":
            asset = self._meshes.get(values.get("mesh", ""))
            if asset is None:
                return None, values.get("mesh", "")
            file = self._folder / asset.get("file", "")
            scale = self.numbers.several(asset, "scale", (1.0, 1.0, 1.0), place)
            if not is_file(file):
                return None, asset.get("file", "")
            return Shape(use, "mesh", tuple(scale), pose, file.resolve()), ""
        text = values.get("size", "").split()
        numbers = self.numbers.several(
            element, "size", (0.0,) * max(len(text), 1), place, values
        )
        if "fromto" in values:
            ends = self.numbers.several(element, "fromto", (0.0,) * 6, place, values)
            first, second = ends[:3], ends[3:]
            pose = along(first, second)
            numbers = np.array([numbers[0], np.linalg.norm(second - first) / 2])
        if kind in ("cylinder", "capsule") and len(numbers) >= 2:
            size: tuple[float, ...] = (numbers[0], 2 * numbers[1])
        elif kind == "box" and len(numbers) == 3:
            size = tuple(2 * numbers)
        elif kind in ("sphere", "ellipsoid"):
            size = tuple(numbers[: 1 if kind == "sphere" else 3])
        else:
            return None, ""
        return Shape(use, kind, size, pose), ""

    def _values(self, element: ET.Element, inherited: str) -> Attributes:
        """Attributes of an element, with those of its class."""
        of_class = self._classes.get(element.get("class", inherited), {})
        return {**of_class.get(element.tag, {}), **element.attrib}

    def _place(
        self, element: ET.Element, values: Mapping[str, str], place: str
    ) -> Place:
        position = self.numbers.several(element, "pos", ZERO, place, values)
        turn = np.eye(3)
        if "quat" in values:
            found = self.numbers.several(
                element, "quat", (1.0, 0.0, 0.0, 0.0), place, values
            )
            if np.linalg.norm(found) > 0:
                w, x, y, z = found
                turn = Rotation.from_quat([x, y, z, w]).as_matrix()
            else:
                wanted = "a quaternion other than zero"
                self.numbers.add(element, "quat", values["quat"], place, wanted)
        elif "euler" in values:
            angles = self.numbers.several(element, "euler", ZERO, place, values)
            turn = self._of_euler(angles * self._angle)
        elif "axisangle" in values:
            *axis, angle = self.numbers.several(
                element, "axisangle", (0.0, 0.0, 1.0, 0.0), place, values
            )
            unit = np.array(axis) / (np.linalg.norm(axis) or 1.0)
            turn = Rotation.from_rotvec(unit * angle * self._angle).as_matrix()
        return Place(turn, position)

    def _of_euler(self, angles: np.ndarray) -> np.ndarray:
        """Rotation by three angles [rad]; axes in lower case turn with the body, in upper case they stay."""
        turn = np.eye(3)
        for letter, angle in zip(self._euler, angles, strict=True):
            one = Rotation.from_euler(letter.lower(), angle).as_matrix()
            turn = turn @ one if letter.islower() else one @ turn
        return turn


# The robot file behind a path, a known name or a case, without building the robot.


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
