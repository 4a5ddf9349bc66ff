"""A robot's file as it is written, URDF or MJCF: links, joints and shapes with their lines; nothing is refused."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from pinocchio import SE3, exp3
from scipy.spatial.transform import Rotation

from gapscope.arm.display import figures
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_NUMBER, is_file, read_bytes
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import check_size

# --- what a file holds


@dataclass(frozen=True)
class Unreadable:
    """Something that a URDF does not say as it should; its default stands in.

    Attributes:
        place: the link or joint, or ``shape of`` one.
        line: of the element.
        element: with its attribute, ``<mass value>``.
        got: what stands there; ``None``: nothing.
        wanted: what was expected.
    """

    place: str
    line: int
    element: str
    got: str | None
    wanted: str

    @property
    def remedy(self) -> str:
        """What to do."""
        if self.got is None:
            return "give mass [kg] and inertia [kg m^2], or leave <inertial> out of a link that has no mass"
        return "correct the attribute"

    @property
    def problem(self) -> str:
        """What is wrong."""
        if self.got is None:
            return f"has no {self.wanted}"
        return f"expected {self.wanted}, got {self.got!r}"

    def error(self, path: Path) -> InputError:
        """The error of what cannot do without."""
        where = f"line {self.line}, {self.place}, {self.element}"
        return InputError(self.problem, self.remedy, file=path, where=where)


@dataclass(frozen=True)
class Inertial:
    """Mass and moments of a link alone.

    Attributes:
        line: in the file.
        mass: [kg].
        com: centre of mass in the link's frame [m], shape (3,).
        moments: inertia about the centre of mass, in axes of the link's frame [kg m^2], shape (3, 3).
        own: the same in the axes of the file's inertial frame [kg m^2], shape (3, 3).
    """

    line: int
    mass: float
    com: np.ndarray
    moments: np.ndarray
    own: np.ndarray

    @property
    def diagonal(self) -> np.ndarray:
        """Moments of inertia ixx, iyy, izz as the file has them [kg m^2], shape (3,)."""
        return np.diag(self.own)

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
        kind: ``mesh``, ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``ellipsoid``, or another word.
        size: full edges [m]; radius and length of a cylinder [m] (of a capsule without its caps); radius, or half axes
            [m]; scale of a mesh [1]; empty if it is not known.
        place: of the shape in the link's frame.
        named: the mesh as the file names it.
        mesh: its file; ``None`` if it is no mesh, or was not found.
        colour: red, green, blue and opacity, 0 to 1, or ``None``.
        mass: that an MJCF file gives it [kg], else it has ``density`` [kg/m^3].
    """

    use: str
    kind: str
    size: tuple[float, ...]
    place: SE3
    named: str = ""
    mesh: Path | None = None
    colour: tuple[float, ...] | None = None
    mass: float | None = None
    density: float = 1000.0

    @property
    def lost(self) -> bool:
        """Whether it is a mesh that was not found."""
        return self.kind == "mesh" and self.mesh is None


@dataclass(frozen=True)
class Link:
    """A link of a URDF, a body of an MJCF file.

    Attributes:
        name, line: in the file; line 0 of the world, and between several joints of one body.
        inertial: as the file has it, or ``None``.
        drawn: its shapes, those of unknown size and lost meshes among them.
    """

    name: str
    line: int
    inertial: Inertial | None
    drawn: tuple[Shape, ...] = ()

    @property
    def where(self) -> tuple[str, int]:
        """Place and line of a finding about it: those of its inertial, if it has one."""
        return f"link {self.name}", self.inertial.line if self.inertial else self.line

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Shapes whose size is known."""
        return tuple(shape for shape in self.drawn if shape.size and not shape.lost)

    @property
    def lost(self) -> tuple[str, ...]:
        """Meshes that were not found, as the file names them, each once."""
        return tuple(dict.fromkeys(shape.named for shape in self.drawn if shape.lost))


@dataclass(frozen=True)
class Mimic:
    """q = multiplier * q_master + offset, as ``<mimic>`` of a URDF has it.

    Attributes:
        master: name of the joint that is followed.
        multiplier: [1], or [m/rad] if one of the joints slides.
        offset: [rad or m].
    """

    master: str
    multiplier: float = 1.0
    offset: float = 0.0


SINGLE = ("revolute", "prismatic")
"""Kinds of joints with one degree of freedom."""
SEVERAL = ("floating", "planar", "ball")
"""Kinds of joints with more."""


@dataclass(frozen=True)
class Joint:
    """A joint between two links; numbers that the file does not give are ``None``.

    Attributes:
        name, line: in the file.
        kind: ``revolute`` (continuous too), ``prismatic``, ``fixed`` or another word.
        parent, child: names of links.
        place: of the child in the parent's frame.
        axis: as written, shape (3,).
        anchor: a point on the axis in the child's frame [m], shape (3,).
        turns_freely: whether it is declared to have no limits.
        mimic: the joint that it follows, if any.
        lower, upper: position limits [rad or m].
        effort: [N m or N].
        velocity: [rad/s or m/s].
        damping: [N m s/rad], friction: [N m], armature: [kg m^2].
        reference: position that the pose of the file has, of MJCF [rad or m].
        gains: kp [N m/rad] and kd [N m s/rad] of an actuator of MJCF that holds its position; none by default.
    """

    name: str
    line: int
    kind: str
    parent: str
    child: str
    place: SE3
    axis: np.ndarray
    anchor: np.ndarray
    turns_freely: bool = False
    mimic: Mimic | None = None
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    damping: float | None = None
    friction: float | None = None
    armature: float | None = None
    reference: float = 0.0
    gains: tuple[float, ...] = ()

    @property
    def where(self) -> tuple[str, int]:
        """Place and line of a finding about it."""
        return f"joint {self.name}", self.line

    @property
    def moves(self) -> bool:
        """Whether it has one degree of freedom of its own."""
        return self.kind in SINGLE and self.mimic is None


@dataclass(frozen=True)
class Description:
    """A robot file as it stands, and the tree of its joints.

    Attributes:
        file: where it is.
        form: ``URDF`` or ``MJCF``.
        name: of the robot.
        links, joints: in the order of the file, fixed joints included.
        unreadable: what it does not say as it should.
        unread: what acts by an MJCF file and is not read, a sentence each, with the joint that it acts on, or an empty
            text.
        gravity: of an MJCF file, in the world's frame [m/s^2], shape (3,); ``None`` if it does not say.
    """

    file: Path
    form: str
    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    unreadable: tuple[Unreadable, ...] = ()
    unread: tuple[tuple[str, str], ...] = ()
    gravity: np.ndarray | None = None

    @cached_property
    def by_name(self) -> dict[str, Link]:
        """Links by their names."""
        # of two links of one name the last; the check of the tree says so
        return {link.name: link for link in self.links}

    @cached_property
    def above(self) -> dict[str, Joint]:
        """Joints by the link that they hold."""
        return {joint.child: joint for joint in self.joints}

    @property
    def moving(self) -> tuple[Joint, ...]:
        """Joints with one degree of freedom, those that follow another included."""
        return tuple(joint for joint in self.joints if joint.kind in SINGLE)

    @property
    def single(self) -> dict[str, Joint]:
        """The same by their names."""
        return {joint.name: joint for joint in self.moving}

    def below(self, link: str) -> list[Joint]:
        """Joints that a link holds, whose child is in the file; of a URDF in the order of their names."""
        # by name: the order in the file does not change that of the arm's joints
        found = [j for j in self.joints if j.parent == link and j.child in self.by_name]
        return sorted(found, key=lambda j: j.name if self.form == "URDF" else "")

    def upwards(self, link: str) -> Iterator[Joint]:
        """Joints from a link to the root, or once around a loop."""
        passed: set[str] = set()
        # a broken file may close a loop: each link is passed once
        while (joint := self.above.get(link)) is not None and link not in passed:
            passed.add(link)
            yield joint
            link = joint.parent

    def is_moved(self, link: str) -> bool:
        """Whether a joint that is not fixed lies between a link and the base."""
        return any(joint.kind != "fixed" for joint in self.upwards(link))

    def moved(self, joints: Collection[str]) -> frozenset[str]:
        """Links that any of these joints moves."""
        return frozenset(
            link
            for link in self.above
            if any(joint.name in joints for joint in self.upwards(link))
        )

    def carriers(self, joints: Collection[str]) -> frozenset[str]:
        """Joints between the root and these joints, which decide how the arm is mounted."""
        parents = [joint.parent for joint in self.joints if joint.name in joints]
        return frozenset(
            joint.name for parent in parents for joint in self.upwards(parent)
        )

    def around(self, joints: Collection[str]) -> frozenset[str]:
        """Links whose joints concern an arm: that it moves, that carry it, and those of joints that follow its own."""
        own = set(joints)
        # a follower of a follower needs another round; there are no more than joints
        for _ in self.joints:
            own |= {j.name for j in self.joints if j.mimic and j.mimic.master in own}
        names = own | self.carriers(own)
        links = {joint.child for joint in self.joints if joint.name in names}
        return self.moved(own) | links

    def chain(self, base: str, tip: str) -> tuple[str, ...]:
        """Joints that move the tip against the base, from the base on.

        Raises:
            InputError: no such link, the tip does not hang on the base, or nothing moves between them.
        """
        links = {end for joint in self.joints for end in (joint.parent, joint.child)}
        for link in (base, tip):
            if link not in links:
                raise InputError(
                    f"has no link {link!r}",
                    f"{nearest(link, links)}name links of the file in chain: [base, tip]",
                    file=self.file,
                )
        way = list(self.upwards(tip))
        carriers = [joint.parent for joint in way]
        if base not in carriers:
            raise InputError(
                f"the link {tip!r} does not hang on {base!r}, but on {' <- '.join(carriers) or 'nothing'}",
                "give the base first, then the tip, in chain: [base, tip]",
                file=self.file,
            )
        # from the tip to the base, then turned round
        found = way[carriers.index(base) :: -1]
        names = tuple(joint.name for joint in found if joint.moves)
        if not names:
            raise InputError(f"no joint moves {tip!r} against {base!r}", file=self.file)
        return names

    def rigid_part(self, link: str) -> list[tuple[Link, SE3]]:
        """A link and what fixed joints hold below it, with their places in its frame."""
        found: dict[str, tuple[Link, SE3]] = {}
        waiting = [(link, SE3.Identity())]
        while waiting:
            name, place = waiting.pop()
            if name in found:  # a loop of fixed joints, which a broken file may have
                continue
            found[name] = self.by_name[name], place
            for joint in self.below(name):
                if joint.kind == "fixed":
                    waiting.append((joint.child, place * joint.place))
        return list(found.values())

    def in_tree_order(self) -> list[Link]:
        """Links from the roots on, each before those that it holds and branch by branch."""
        order: dict[str, Link] = {}
        waiting = [link.name for link in self.links if link.name not in self.above]
        # a stack: reversed, so that the first branch is followed first
        waiting.reverse()
        while waiting:
            name = waiting.pop()
            if name not in order:
                order[name] = self.by_name[name]
                waiting += [joint.child for joint in self.below(name)][::-1]
        return list(order.values())


# --- the text of a file

UNEXPANDED = re.compile(r"<xacro:|\$\((find|arg|eval|env|optenv)\b|\$\{")
"""Marks of xacro in a file that was not expanded."""
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
ZERO = (0.0, 0.0, 0.0)
Lines = dict[ET.Element, int]
"""Line, counted from 1, on which an element begins."""


def read_description(path: Path, *, shapes: bool = True) -> Description:
    """A URDF or MJCF file as it stands.

    Args:
        path: the file.
        shapes: whether shapes of a URDF are read as well.

    Raises:
        InputError: there is no such file, it is not XML, or no robot; a xacro file comes with the command that expands
            it.
    """
    content = read_bytes(path, "check the robot: entry of the case")
    text = content.decode("utf-8", "replace")
    # xacro marks in a comment do no harm
    if path.suffix == ".xacro" or UNEXPANDED.search(COMMENT.sub("", text)):
        raise InputError(
            "is xacro, from which a URDF is made first",
            f"xacro {path.name} > robot.urdf, with xacro of ROS or of pip install xacrodoc (xacrodoc {path.name} -o "
            "robot.urdf)",
            file=path,
        )
    root, lines = _read_xml(content, path)
    if root.tag == "robot":
        return _UrdfReader(root, lines, path).description(shapes)
    if root.tag == "mujoco":
        return _MjcfReader(text, lines, path).description(root.get("model"))
    raise InputError(
        f"root element is <{root.tag}>, expected <robot> or <mujoco>",
        "give a URDF or MJCF file",
        file=path,
        where=f"line {lines[root]}",
    )


def _read_xml(content: bytes, path: Path) -> tuple[ET.Element, Lines]:
    """Root element, and the lines of all elements."""
    builder, lines = ET.TreeBuilder(), Lines()
    parser = expat.ParserCreate()
    parser.buffer_text = True

    # ElementTree's own parser keeps no lines, and every message names one
    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
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


def moments_matrix(moments: Iterable[float]) -> np.ndarray:
    """The matrix of ixx, ixy, ixz, iyy, iyz, izz, shape (3, 3)."""
    xx, xy, xz, yy, yz, zz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertial_of(line: int, pose: SE3, mass: float, own: np.ndarray) -> Inertial:
    """Of moments in axes of an inertial frame, (3, 3), which is placed in the link's."""
    # from the axes of the inertial's frame into those of the link
    turned = pose.rotation @ own @ pose.rotation.T
    return Inertial(line, mass, pose.translation, turned, own)


# --- URDF

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
SIZES: dict[str, dict[str, tuple[float, ...]]] = {
    "box": {"size": ZERO},
    "cylinder": {"radius": (0.0,), "length": (0.0,)},
    "capsule": {"radius": (0.0,), "length": (0.0,)},
    "sphere": {"radius": (0.0,)},
}
"""Attributes of the primitives, with as many zeros as they have numbers."""
SCHEMES = ("package://", "model://", "file://")
"""How a URDF may begin the path of a mesh."""


def pybullet_data() -> Path | None:
    """Folder of the package of models that comes with PyBullet, or ``None``."""
    package = find_spec("pybullet_data")
    if package is None or not package.submodule_search_locations:
        return None
    return Path(package.submodule_search_locations[0])


def find_mesh(name: str, urdf: Path) -> Path | None:
    """File of a mesh that a URDF names, or ``None`` if it is not found.

    A path after ``package://`` starts from the folder of the URDF or one of the three above it, with the package's
    name or without; that of ``pybullet_data`` from the installed package too.
    """
    scheme = next((s for s in SCHEMES if name.startswith(s)), "")
    rest = Path(name[len(scheme) :])
    in_package = scheme in SCHEMES[:2]
    # the package's folder may have another name than the package
    without_package = Path(*rest.parts[1:]) if len(rest.parts) > 1 else rest
    parts = (rest, without_package) if in_package else (rest,)
    folders = list(urdf.resolve().parents[: 4 if in_package else 1])
    if in_package and rest.parts[:1] == ("pybullet_data",):
        folders += filter(None, [pybullet_data()])
    files = (folder / part for part in parts for folder in folders)
    return next((file.resolve() for file in files if is_file(file)), None)


class _UrdfReader:
    """Reads links and joints of a URDF; what is no number is noted, and the default is used."""

    def __init__(self, root: ET.Element, lines: Lines, path: Path) -> None:
        self.root, self.path, self.lines = root, path, lines
        self.unreadable: list[Unreadable] = []

    def description(self, shapes: bool) -> Description:
        """The whole file."""
        # a colour by name is defined once, for the whole robot
        named = {m.get("name", ""): self._rgba(m) for m in self.root.iter("material")}
        self._colours = {name: rgba for name, rgba in named.items() if name and rgba}
        links = [self._link(element, shapes) for element in self.root.findall("link")]
        joints = [self._joint(element) for element in self.root.findall("joint")]
        name = self.root.get("name") or self.path.stem
        return Description(
            self.path,
            "URDF",
            name,
            tuple(links),
            tuple(joints),
            tuple(self.unreadable),
        )

    def several(
        self, element: ET.Element | None, key: str, default: Iterable[float], place: str
    ) -> np.ndarray:
        """As many numbers as the default has."""
        usual = np.array(list(default), dtype=float)
        text = None if element is None else element.get(key)
        if element is None or text is None:
            return usual
        try:
            found = np.array(text.split(), dtype=float)
        except ValueError:
            # a wrong count of numbers, or one beyond computing, is noted like text
            found = np.array([np.nan])
        if len(found) == len(usual) and (np.abs(found) < LARGEST_NUMBER).all():
            # numbers next to nothing would overflow once they are divided by
            return np.where(np.abs(found) > 1 / LARGEST_NUMBER, found, 0.0)
        count = len(usual)
        wanted = "a number" if count == 1 else f"{count} numbers"
        self.note(element, key, place, wanted)
        return usual

    def one(
        self, element: ET.Element | None, key: str, place: str, limit: bool = False
    ) -> float | None:
        """A number, or ``None`` if it is not given or none; that of a limit may be infinite."""
        text = None if element is None else element.get(key)
        if text is None:
            return None
        # "inf" or a huge number is how files write that there is no limit
        with suppress(ValueError):
            if limit and abs(float(text)) >= LARGEST_NUMBER:
                return math.copysign(math.inf, float(text))
        # a number that could not be read counts as not given
        noted = len(self.unreadable)
        value = float(self.several(element, key, (0.0,), place)[0])
        return value if len(self.unreadable) == noted else None

    def note(self, element: ET.Element, key: str, place: str, wanted: str) -> None:
        """Note that an attribute is not what is wanted, or without one that an element lacks it."""
        name, line = f"<{f'{element.tag} {key}'.strip()}>", self.lines[element]
        self.unreadable.append(Unreadable(place, line, name, element.get(key), wanted))

    def _link(self, element: ET.Element, shapes: bool) -> Link:
        name, inertial = element.get("name", "").strip(), element.find("inertial")
        drawn = [*element.findall("visual"), *element.findall("collision")]
        return Link(
            name,
            self.lines[element],
            None if inertial is None else self._inertial(inertial, f"link {name}"),
            # bodies and joints need no shapes, whose meshes would be looked for
            tuple(self._shape(x, f"shape of link {name}") for x in drawn if shapes),
        )

    def _joint(self, element: ET.Element) -> Joint:
        name = element.get("name", "").strip()
        place, written = f"joint {name}", element.get("type", "")
        limit, dynamics = element.find("limit"), element.find("dynamics")
        ends = [element.find(tag) for tag in ("parent", "child")]
        parent, child = (
            "" if end is None else end.get("link", "").strip() for end in ends
        )
        follows = element.find("mimic")
        mimic = None
        if follows is not None:
            factor, offset = (
                self.one(follows, key, place) for key in ("multiplier", "offset")
            )
            factor = 1.0 if factor is None else factor
            mimic = Mimic(follows.get("joint", ""), factor, offset or 0.0)
        numbers: dict[str, Any] = {
            key: self.one(limit, key, place, limit=True)
            for key in ("lower", "upper", "effort", "velocity")
        }
        for key in ("damping", "friction"):
            numbers[key] = self.one(dynamics, key, place)
        return Joint(
            name,
            self.lines[element],
            "revolute" if written == "continuous" else written,
            parent,
            child,
            self._place(element, place),
            # an axis is x if the file says nothing, as URDF has it
            self.several(element.find("axis"), "xyz", (1.0, 0.0, 0.0), place),
            np.zeros(3),
            written == "continuous",
            mimic,
            **numbers,
        )

    def _inertial(self, element: ET.Element, place: str) -> Inertial:
        values: dict[str, float] = {}
        # all six moments are asked for: none is zero by default
        for tag, keys in (("mass", ("value",)), ("inertia", MOMENTS)):
            part = element.find(tag)
            lacking = [key for key in keys if part is None or part.get(key) is None]
            if lacking:
                self.note(element, "", place, f"<{tag} {lacking[0]}>")
            values |= {key: self.one(part, key, place) or 0.0 for key in keys}
        own = moments_matrix(values[name] for name in MOMENTS)
        pose = self._place(element, place)
        return inertial_of(self.lines[element], pose, values["value"], own)

    def _place(self, element: ET.Element, place: str) -> SE3:
        """Place by the ``<origin>`` of an element."""
        origin = element.find("origin")
        # fixed axes, in the order roll, pitch, yaw
        xyz, rpy = (self.several(origin, key, ZERO, place) for key in ("xyz", "rpy"))
        return SE3(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)

    def _shape(self, element: ET.Element, place: str) -> Shape:
        geometry, pose = element.find("geometry"), self._place(element, place)
        material = element.find("material")
        colour = None if material is None else self._rgba(material)
        # a material that is only named takes the colour that the robot gives the name
        if material is not None and material.find("color") is None:
            colour = self._colours.get(material.get("name", ""))
        # a shape without <geometry> has the tag of its use, which is of no known size
        form = geometry[0] if geometry is not None and len(geometry) else element
        named = form.get("filename", "")
        counts = SIZES.get(form.tag, {})
        mesh = None
        if form.tag == "mesh":
            mesh = find_mesh(named, self.path)
            size = self.several(form, "scale", np.ones(3), place)
        else:
            parts = [self.several(form, k, zeros, place) for k, zeros in counts.items()]
            size = np.concatenate([*parts, []])
        extent = tuple(size.tolist())
        return Shape(element.tag, form.tag, extent, pose, named, mesh, colour)

    def _rgba(self, material: ET.Element) -> tuple[float, ...] | None:
        colour = material.find("color")
        if colour is None:
            return None
        return tuple(self.several(colour, "rgba", np.ones(4), "shape").tolist())


# --- MJCF

KINDS = {"hinge": "revolute", "slide": "prismatic", "free": "floating"}
NAMELESS = "without_a_name"
FULL = {
    "box": (2, 2, 2),
    "cylinder": (1, 2),
    "capsule": (1, 2),
    "sphere": (1,),
    "ellipsoid": (1, 1, 1),
}
"""Sizes of primitives over those of MJCF, which are half lengths."""


def turn_of_z(direction: np.ndarray) -> np.ndarray:
    """The shortest turn from the z axis to a direction; unity of none, shape (3, 3)."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    size = np.linalg.norm(axis)
    angle = np.arctan2(size, direction[2])
    # about any axis across it to the opposite direction
    return exp3(angle * (axis / size if size else np.array([1.0, 0.0, 0.0])))


class _MjcfReader:
    """Links and joints of an MJCF file as MuJoCo reads it, with what default classes, frames and replicates give them.

    Bodies without a name get one. Several joints of one body are a chain of links.

    Raises:
        InputError: it is no MJCF, or has parts in other files.
    """

    def __init__(self, text: str, lines: Lines, path: Path) -> None:
        import mujoco

        for element, line in lines.items():
            if element.tag in ("include", "attach"):
                raise InputError(
                    f"<{element.tag}> is not read",
                    "expand it in the file",
                    file=path,
                    where=f"line {line}",
                )
            # MuJoCo takes what no number can be computed with
            for key, value in element.attrib.items():
                if _overflows(value):
                    raise InputError(
                        f"expected numbers, got {value!r}",
                        "correct the attribute",
                        file=path,
                        where=f"line {line}, <{element.tag} {key}>",
                    )
        try:
            self.spec = mujoco.MjSpec.from_string(text)
        except ValueError as error:
            # what is wrong, and below it the element with its line
            said = str(error).removeprefix("XML Error: ").splitlines()[0]
            place = re.search(r"Element '(.*)', (line \d+)", str(error))
            where = f"{place[2]}, <{place[1]}>" if place else ""
            raise InputError(
                f"is not valid MJCF: {said}", "correct it", file=path, where=where
            ) from None
        flag = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        self.weightless = bool(self.spec.option.disableflags & flag)
        self.path = path
        self.unread: list[tuple[str, str]] = []

    def description(self, name: str | None) -> Description:
        """The whole file; the world is the first link, bodies that MuJoCo weighs by their shapes have no inertial."""
        spec = self.spec
        if spec.tendons:
            self.unread.append(("", "<tendon> is not read"))
        for key in ("settotalmass", "boundmass", "boundinertia", "balanceinertia"):
            if getattr(spec.compiler, key) > 0:
                self.unread.append(("", f"<compiler {key}> is not read"))
        self._meshes = {mesh.name: mesh for mesh in spec.meshes}
        # before bodies, whose joints ask what actuators and equalities say
        self._mimics = self._equalities()
        self._read_actuators()
        links, joints = [Link("world", 0, None)], list[Joint]()
        for number, body in enumerate(spec.bodies[1:], start=1):
            # names are written back: what hangs on a body finds it by them
            body.name = body.name or f"{NAMELESS}_{number}"
            self._body(body, links, joints)
        gravity = np.array(spec.option.gravity)
        if self.weightless:
            gravity = np.zeros(3)
        return Description(
            self.path,
            "MJCF",
            name or self.path.stem,
            tuple(links),
            tuple(joints),
            unread=tuple(self.unread),
            gravity=gravity,
        )

    def _equalities(self) -> dict[str, Mimic]:
        """Joints that ``<equality>`` lets follow another one in proportion; other constraints are not read."""
        found = {}
        for equality in self.spec.equalities:
            kind, ends = _word(equality.type), (equality.name1, equality.name2)
            # q = c0 + c1 q_master; higher powers are no proportion
            offset, factor, *higher = map(float, equality.data[:5])
            if kind == "joint" and all(ends) and not any(higher):
                if equality.active:
                    found[ends[0]] = Mimic(ends[1], factor, offset)
                continue
            between = ", ".join(filter(None, ends)) or "unnamed parts"
            said = (
                f"<equality><{kind}> of {between} is not read: what it holds together moves freely, or is "
                "locked if it is none of the arm's joints"
            )
            self.unread.append(("", said))
        return found

    def _read_actuators(self) -> None:
        """Limits and gains that actuators give joints.

        The limit of a torque is ``forcerange``, of plain motors ``ctrlrange`` too, times the gear. A ``position``
        actuator commands gear kp (u - gear q) - gear^2 kv dq: kp and kd about the joint are gear^2 times its own; to
        MuJoCo it is a ``general`` one whose ``biastype`` is affine, with ``biasprm`` [b0, -kp, -kd].
        """
        self._limits, self._gains = dict[str, float](), dict[str, tuple[float, ...]]()
        for actuator in self.spec.actuators:
            name, bias = actuator.target, _word(actuator.biastype)
            if _word(actuator.trntype) != "joint":
                continue
            gear = abs(float(actuator.gear[0]))
            limit = _bound(actuator.forcerange, actuator.forcelimited)
            # only of a plain motor the control is a torque
            if bias == "none" and _word(actuator.gaintype) == "fixed":
                control = _bound(actuator.ctrlrange, actuator.ctrllimited)
                limit = min(limit, abs(float(actuator.gainprm[0])) * control)
            # of several actuators on a joint the lowest limit
            self._limits[name] = min(self._limits.get(name, np.inf), gear * limit)
            if bias == "affine":
                # through the gear to the actuator's length, and back to torque
                self._gains[name] = tuple(-(gear**2) * actuator.biasprm[1:3])

    def _body(self, body: Any, links: list[Link], joints: list[Joint]) -> None:
        """Add a body and its joints."""
        name, parent, line = body.name, body.parent.name, _line(body)
        if body.gravcomp:
            said = f"gravcomp of body {name} is not read: its weight is not held up"
            self.unread.append(("", said))
        place = self._place(body)
        own = list(body.joints)
        # joints of one body act one after the other, on links without anything between
        for number, joint in enumerate(own, 1):
            child = name
            if number < len(own):
                child = f"{name} after joint {number}"
                links.append(Link(child, 0, None))
            joints.append(self._joint(joint, parent, child, place, line))
            parent, place = child, SE3.Identity()
        # a body without a joint is fixed to its parent
        if not own:
            called, zero = f"{name} (fixed)", np.zeros(3)
            joints.append(Joint(called, line, "fixed", parent, name, place, zero, zero))
        # with inertiafromgeom the file's own inertials have no say
        by_shape = _word(self.spec.compiler.inertiafromgeom) == "true"
        inertial = None
        if body.explicitinertial and not by_shape:
            inertial = self._inertial(body, line)
        elif any(_word(geom.typeinertia) == "shell" for geom in body.geoms):
            self.unread.append(("", f"shellinertia of body {name} is not read"))
        links.append(Link(name, line, inertial, tuple(map(self._shape, body.geoms))))

    def _joint(
        self, joint: Any, parent: str, child: str, pose: SE3, line: int
    ) -> Joint:
        name, kind = joint.name or f"joint of {child}", _word(joint.type)
        kind = KINDS.get(kind, kind)
        given = bool(np.any(joint.range)) and _word(joint.limited) != "false"
        # degrees are of angles alone
        degrees = kind == "revolute" and self.spec.compiler.degree
        limits = np.deg2rad(joint.range) if degrees else joint.range
        lower, upper = map(float, limits) if given else (None, None)
        limit = _bound(joint.actfrcrange, joint.actfrclimited)
        limit = min(limit, self._limits.get(name, np.inf))
        # what pushes the joint and is not simulated is said, not passed over
        if np.any(joint.stiffness):
            said = (
                f"the spring of joint {name} (stiffness {joint.stiffness[0]:g}, springref {joint.springref:g}) is "
                "not read; give it as the effect parallel_spring"
            )
            self.unread.append((name, said))
        if np.any(joint.springdamper):
            self.unread.append((name, f"springdamper of joint {name} is not read"))
        frame = self._frames(joint)
        return Joint(
            name,
            _line(joint) or line,
            kind,
            parent,
            child,
            pose,
            frame.rotation @ joint.axis,
            frame.act(np.array(joint.pos)),
            not given,
            self._mimics.get(name),
            lower,
            upper,
            # a limit of zero stands for none
            limit if 0 < limit < np.inf else None,
            None,
            float(joint.damping[0]),
            float(joint.frictionloss),
            float(joint.armature),
            float(joint.ref),
            self._gains.get(name, ()),
        )

    def _inertial(self, body: Any, line: int) -> Inertial:
        pose, own = self._pose(body.ipos, body.iquat, body.ialt), np.diag(body.inertia)
        if not np.isnan(body.fullinertia[0]):
            # fullinertia is xx yy zz xy xz yz
            own = moments_matrix(np.array(body.fullinertia)[[0, 3, 4, 1, 5, 2]])
        elif not own.any():
            raise InputError(
                "has no diaginertia",
                "give mass [kg] and inertia [kg m^2], or leave <inertial> out of a body that has no mass",
                file=self.path,
                where=f"line {line}, body {body.name}, <inertial>",
            )
        return inertial_of(line, pose, float(body.mass), own)

    def _shape(self, geom: Any) -> Shape:
        kind, mesh = _word(geom.type), self._meshes.get(geom.meshname)
        # a primitive that is fitted to a mesh is as large as that
        named, file = geom.meshname, None
        # shapes that touch nothing are there to be seen
        use = "collision" if geom.contype or geom.conaffinity else "visual"
        pose, half = self._place(geom), np.array(geom.size)
        if not np.isnan(geom.fromto[0]):
            ends = np.array(geom.fromto).reshape(2, 3)
            # in the middle, with the z axis from the one end to the other
            way = ends[1] - ends[0]
            pose = self._frames(geom) * SE3(turn_of_z(way), ends.mean(axis=0))
            half[1] = np.linalg.norm(way) / 2
        size = [k * x for k, x in zip(FULL.get(kind, ()), half, strict=False)]
        if kind == "mesh" and mesh is not None:
            named, size = mesh.file, list(mesh.scale)
            path = self.path.parent / self.spec.meshdir / named
            file = path.resolve() if is_file(path) else None
        extent = tuple(map(float, size)) if np.all(size) else ()
        mass = None if np.isnan(geom.mass) else float(geom.mass)
        low, high = self.spec.compiler.inertiagrouprange
        # shapes of other groups weigh nothing
        if not low <= geom.group <= high:
            mass = 0.0
        density = float(geom.density)
        return Shape(use, kind, extent, pose, named, file, None, mass, density)

    def _place(self, element: Any) -> SE3:
        """Place of an element in its body."""
        return self._frames(element) * self._pose(
            element.pos, element.quat, element.alt
        )

    def _frames(self, element: Any) -> SE3:
        """Place of the frames around an element in its body."""
        place, frame = SE3.Identity(), element.frame
        while frame is not None:
            place = self._pose(frame.pos, frame.quat, frame.alt) * place
            frame = frame.frame
        return place

    def _pose(self, position: Any, quaternion: Any, other: Any) -> SE3:
        """Place by a position and a turn, given as a quaternion or in another way; unity of a turn that is none."""
        if _word(other.type) != "quat":
            compiler = self.spec.compiler
            quaternion = self.spec.resolve_orientation(
                degree=compiler.degree, sequence=compiler.eulerseq, orientation=other
            )
        turn = np.eye(3)
        if np.any(quaternion):
            # w x y z of MJCF, x y z w of SciPy
            turn = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
        return SE3(turn, np.array(position))


def _overflows(text: str) -> bool:
    """Whether an attribute has numbers of which one is none, or too large to compute with."""
    with suppress(ValueError):
        numbers = np.array(text.split(), dtype=float)
        return not (np.abs(numbers) < LARGEST_NUMBER).all()
    return False


def _word(member: Any) -> str:
    """The word of MJCF for a member of an enumeration of MuJoCo, ``mjJNT_HINGE``."""
    return str(member.name).rpartition("_")[2].lower()


def _line(element: Any) -> int:
    """Line of an element that MuJoCo has read; 0 if it does not say."""
    return int(element.info.rpartition(" ")[2] or 0)


def _bound(allowed: Any, limited: Any) -> float:
    """What a range allows to either side; infinite if there is none."""
    # the smaller side: limits here have one size for both directions
    bound = float(np.abs(allowed).min())
    return np.inf if _word(limited) == "false" or not np.any(allowed) else bound


# --- whether what concerns an arm can be

UNWEIGHED = ("mesh", "plane", "hfield", "sdf")
"""Shapes whose mass is not known here."""


def checked(description: Description, joints: Collection[str] = ()) -> Description:
    """What of a file concerns an arm, checked; impossible inertials of links that do not move with it are left out.

    Args:
        description: of the file.
        joints: the arm's; by default none, and all of the file's tree is checked.

    Raises:
        InputError: a number is none, the joints are no tree, or a body that moves is none that can be.
    """
    path, moved = description.file, description.moved(joints)
    links = description.around(joints)
    # of the whole file if no arm is named, else of what concerns it
    used = tuple(j for j in description.joints if not joints or j.child in links)
    names = {f"joint {joint.name}": joint.name for joint in used}
    for found in description.unreadable:
        name = names.get(found.place)
        # the limits of a joint that is locked have no say
        idle = joints and name not in joints and found.element.startswith("<limit")
        if name is not None and not idle:
            raise found.error(path)
    bases = [x.name for x in description.links if x.name not in description.above]
    # of an arm named by its joints other bases of the file do not matter
    _check_tree(description, used, () if joints else bases)
    for joint in used:
        where = f"line {joint.line}, joint {joint.name}"
        check_size(joint.place.translation, "length", path, where)
        if joint.kind in SINGLE and not np.linalg.norm(joint.axis) > 0:
            raise InputError(
                "its axis has no direction, so that it moves nothing",
                'correct <axis xyz="...">, or axis of an MJCF file',
                file=path,
                where=where,
            )
        for name in ("effort", "velocity", "friction", "damping"):
            limit = getattr(joint, name)
            if limit is not None and limit < 0:
                raise InputError(
                    f"its {name} is {limit:g}, expected zero or above",
                    "correct the attribute, or leave it out",
                    file=path,
                    where=where,
                )
        if joint.name in joints and joint.reference:
            raise InputError(
                f"ref is {joint.reference:g}, expected 0: positions count from the pose that the file draws",
                "leave ref out and turn the body by it, or move the recorded positions",
                file=path,
                where=f"joint {joint.name}",
            )
    faults = inertial_faults(description)
    for name, fault in faults.items():
        if name in moved:
            raise fault
    # those that stand still may have any inertial: it is left out
    kept = [
        replace(link, inertial=None) if link.name in faults else link
        for link in description.links
    ]
    return replace(description, links=tuple(kept), joints=used)


def inertial_faults(description: Description) -> dict[str, InputError]:
    """What is wrong with inertials that no body can have, by the name of the link.

    A number is missing or none, a mass or a principal moment is negative, a body without inertial has no known weight.
    """
    faults = {}
    tag = "link" if description.form == "URDF" else "body"
    unreadable = {one.place: one for one in description.unreadable}
    for link in description.links:
        found = unreadable.get(f"link {link.name}")
        try:
            if found is not None:
                raise found.error(description.file)
            if link.inertial is not None:
                where = f"line {link.inertial.line}, {tag} {link.name}, <inertial>"
                _check_inertial(link.inertial, description.file, where)
            elif description.form == "MJCF" and any(
                joint.kind in SINGLE for joint in description.upwards(link.name)
            ):
                # a shape whose mass is not known here
                weighed = (shape for shape in link.drawn if shape.mass != 0)
                bad = next((s for s in weighed if s.kind in UNWEIGHED or s.named), None)
                if bad is None:
                    continue
                raise InputError(
                    f"has no <inertial>, and its mass cannot be taken from the shape {bad.named or bad.kind}",
                    'give it one; MuJoCo\'s mj_saveLastXML writes it after <compiler saveinertial="true"/>',
                    file=description.file,
                    where=f"line {link.line}, body {link.name}",
                )
        except InputError as error:
            faults[link.name] = error
    return faults


def _check_inertial(inertial: Inertial, path: Path, where: str) -> None:
    if inertial.mass < 0:
        raise InputError(
            f"mass is {inertial.mass:g} kg, expected zero or above",
            "correct its value",
            file=path,
            where=where,
        )
    check_size(inertial.mass, "mass", path, where)
    check_size(inertial.moments, "moment of inertia", path, where)
    check_size(inertial.com, "length", path, where)
    moments = np.linalg.eigvalsh(inertial.moments)
    # a negative moment within rounding of the largest one, or of a conversion
    if moments[0] < -max(1e-6 * abs(moments[2]), np.finfo(float).eps):
        raise InputError(
            f"it has the principal moments {figures(moments)} kg m^2, expected none below zero",
            "correct the moments: they are about the centre of mass, in the axes of the inertial's frame",
            file=path,
            where=where,
        )


def tree_faults(
    description: Description, joints: Sequence[Joint]
) -> Iterator[tuple[str, Joint, str]]:
    """What keeps joints from holding links of the file in one tree: a word for it, the joint, and the problem."""
    held = Counter(joint.child for joint in joints)
    names = Counter(joint.name for joint in joints)
    known = Counter(link.name for link in description.links)
    for joint in joints:
        # each end once in the file, or the joint hangs nowhere
        odd = [end for end in (joint.parent, joint.child) if known[end] != 1]
        # the way up ends at the base, or goes round
        *_, top = description.upwards(joint.child)
        if odd and not known[odd[0]]:
            said = f"names the link {odd[0]!r}, which the file does not have"
            yield "no_such_link", joint, said
        elif odd:
            said = f"names the link {odd[0]!r}, of which the file has {known[odd[0]]}"
            yield "same_name", joint, said
        elif held[joint.child] > 1:
            yield (
                "held_twice",
                joint,
                f"holds the link {joint.child}, and so do others",
            )
        elif joint.moves and (not joint.name or names[joint.name] > 1):
            yield "same_name", joint, "needs a name of its own"
        elif top.parent in description.above:
            yield "loop", joint, f"its joints close a loop at the link {joint.child!r}"


def _check_tree(
    description: Description, joints: Sequence[Joint], bases: Sequence[str]
) -> None:
    """Check that joints hold links of the file in one tree, and that there is no other base."""
    for _, joint, problem in tree_faults(description, joints):
        raise InputError(
            problem,
            "correct the file: the links of an arm hang on one base, one joint above each; or name the arm in "
            "chain: or joints: of the case, and what does not concern it is not read",
            file=description.file,
            where=f"line {joint.line}, joint {joint.name}",
        )
    tops = ([*description.upwards(joint.child)][-1].parent for joint in joints)
    roots = dict.fromkeys([*bases, *tops])
    if len(roots) > 1:
        raise InputError(
            f"has several bases: {', '.join(roots)}",
            "name the arm in chain: or joints: of the case, and what does not concern it is not read",
            file=description.file,
        )
