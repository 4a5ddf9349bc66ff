"""Shapes of links, their convex hulls, and collisions between them."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations, compress
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from gapscope.arm.dynamics.inertials import inertia_boxes
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import parser_output, with_collision_shapes
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import is_file
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import pybullet_data

# Shapes and named frames of a URDF, placed on the bodies that move them.


SCHEMES = ("package://", "model://", "file://")
"""How a URDF may begin the path of a mesh."""


@dataclass(frozen=True)
class Frame:
    """A link of a URDF as a frame on a moving body.

    Attributes:
        name: of the link.
        joint: name of the joint that moves it, or an empty string for the base.
        position: of the link's frame in that joint's frame [m], shape (3,).
        rotation: of the same, shape (3, 3).
    """

    name: str
    joint: str
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape.

    Attributes:
        use: ``visual`` or ``collision``.
        frame: its place on the moving body; ``name`` is that of its link.
        kind: ``mesh``, ``box``, ``cylinder`` or ``sphere``.
        size: edges of a box [m], radius and length of a cylinder [m], radius of a sphere [m], scale of a mesh [1].
        mesh: file of a mesh, or ``None``.
        colour: red, green, blue and opacity, 0 to 1, or ``None``.
    """

    use: str
    frame: Frame
    kind: str
    size: tuple[float, ...]
    mesh: Path | None = None
    colour: tuple[float, ...] | None = None


def read_frames(body: RigidBody) -> dict[str, Frame]:
    """Links of the URDF by name, those that are fixed to a moving body with their place on it."""
    model = body.model
    found = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            joint = model.names[frame.parentJoint] if frame.parentJoint else ""
            place = frame.placement
            found[frame.name] = Frame(
                frame.name, joint, place.translation.copy(), place.rotation.copy()
            )
    return found


def read_shapes(body: RigidBody) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Shapes of the URDF, and a sentence for each that cannot be used; nothing of an MJCF file."""
    root = ET.parse(body.file).getroot()
    if root.tag != "robot":
        return (), ("shapes: they are read from URDF files alone",)
    frames, colours = read_frames(body), _colours(root)
    shapes, notes = [], []
    for link in root.findall("link"):
        frame = frames.get(link.get("name", ""))
        for element in (*link.findall("visual"), *link.findall("collision")):
            shape = (
                None if frame is None else _shape(element, frame, body.file, colours)
            )
            if shape is None:
                notes.append(
                    f"a {element.tag} shape of link {link.get('name')}: {_said(element)}"
                )
            else:
                shapes.append(shape)
    return tuple(shapes), tuple(dict.fromkeys(notes))


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
    for part in parts:
        for folder in folders:
            if is_file(folder / part):
                return (folder / part).resolve()
    return None


def _shape(
    element: ET.Element, frame: Frame, urdf: Path, colours: dict[str, tuple[float, ...]]
) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not len(geometry):
        return None
    form, origin = geometry[0], element.find("origin")
    xyz, rpy = (
        _numbers(None if origin is None else origin.get(key), "0 0 0")
        for key in ("xyz", "rpy")
    )
    own = Frame(
        frame.name,
        frame.joint,
        frame.position + frame.rotation @ xyz,
        frame.rotation @ pin.rpy.rpyToMatrix(rpy),
    )
    colour = _colour(element.find("material"), colours)
    if form.tag == "mesh":
        mesh = find_mesh(form.get("filename", ""), urdf)
        scale = tuple(_numbers(form.get("scale"), "1 1 1").tolist())
        return (
            None
            if mesh is None
            else Shape(element.tag, own, "mesh", scale, mesh, colour)
        )
    keys = {
        "box": ("size",),
        "cylinder": ("radius", "length"),
        "sphere": ("radius",),
    }.get(form.tag)
    if keys is None:
        return None
    size = tuple(x for key in keys for x in _numbers(form.get(key), "0").tolist())
    return Shape(element.tag, own, form.tag, size, None, colour)


def _said(element: ET.Element) -> str:
    """What cannot be used of a shape."""
    mesh = element.find("geometry/mesh")
    return (
        "it has no known geometry"
        if mesh is None
        else f"the mesh {mesh.get('filename')} is not found"
    )


def _colours(root: ET.Element) -> dict[str, tuple[float, ...]]:
    """Colours of the materials that have a name."""
    named = {m.get("name", ""): _colour(m, {}) for m in root.iter("material")}
    return {name: colour for name, colour in named.items() if name and colour}


def _colour(
    material: ET.Element | None, colours: dict[str, tuple[float, ...]]
) -> tuple[float, ...] | None:
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        return colours.get(material.get("name", ""))
    return tuple(_numbers(colour.get("rgba"), "1 1 1 1").tolist())


def _numbers(text: str | None, otherwise: str) -> np.ndarray:
    return np.array((text or otherwise).split(), dtype=float)


# Convex hulls of an arm's moving bodies, few triangles each, for pictures.


DIRECTIONS = 150
"""Directions in which the farthest point of a body is kept."""
THICKNESS = 0.03
"""Radius of a rod over the length of the stretched arm [1]."""
ROUND = 16
"""Corners of a circle."""


@dataclass(frozen=True)
class Hull:
    """Convex hull of one shape of a body.

    Attributes:
        body: number of the body in kinematic order, from 1; 0 is the base.
        vertices: in the frame of the joint that moves the body [m], shape (V, 3).
        faces: places of the corners of triangles in ``vertices``, seen from outside against the clock, shape (F, 3).
    """

    body: int
    vertices: np.ndarray
    faces: np.ndarray


def link_hulls(body: RigidBody) -> tuple[Hull, ...]:
    """Hulls of the visual shapes of a URDF, or of its collision shapes; a body without any is a rod along the arm."""
    shapes, _ = read_shapes(body)
    found: list[Hull] = []
    for use in ("visual", "collision"):
        drawn = {hull.body for hull in found}
        for shape in shapes:
            joint = shape.frame.joint
            number = body.model.getJointId(joint) if joint else 0
            if shape.use == use and number not in drawn:
                found += _hull(number, _points_of_shape(shape))
    drawn = {hull.body for hull in found}
    bare = [number for number in range(body.model.njoints) if number not in drawn]
    thickness = THICKNESS * reach(body)
    for number in bare:
        for end in _ends(body, number):
            ball = thickness * directions(DIRECTIONS)
            found += _hull(number, np.vstack([ball, ball + end]))
    return tuple(found)


def _ends(body: RigidBody, number: int) -> list[np.ndarray]:
    """Where the joints that a body carries stand in its frame [m], (3,) each; of the last its centre of mass."""
    model = body.model
    children = [k for k in range(1, model.njoints) if model.parents[k] == number]
    if children:
        return [model.jointPlacements[k].translation for k in children]
    return [model.inertias[number].lever]


def reach(body: RigidBody) -> float:
    """Length of the stretched arm [m]."""
    places = list(body.model.jointPlacements)[1:]
    return float(sum(np.linalg.norm(place.translation) for place in places))


def _points_of_shape(shape: Shape) -> np.ndarray:
    """Points whose hull is that of a shape, in the frame of the joint [m], (P, 3); none if its mesh is missing."""
    local = _local_points(shape)
    return local @ shape.frame.rotation.T + shape.frame.position


def _local_points(shape: Shape) -> np.ndarray:
    if shape.kind == "box":
        return box_corners(np.array(shape.size))
    if shape.kind == "sphere":
        return shape.size[0] * directions(DIRECTIONS)
    if shape.kind == "cylinder":
        radius, length = shape.size
        return cylinder_edges(radius, length, ROUND)
    # a picture can do without a mesh: the body is drawn as a box
    points = None if shape.mesh is None else mesh_points(shape.mesh, shape.size)
    return np.empty((0, 3)) if points is None else points


def box_corners(edges: np.ndarray) -> np.ndarray:
    """Corners of a box around the origin, (8, 3)."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return 0.5 * signs * edges


def cylinder_edges(radius: float, length: float, count: int) -> np.ndarray:
    """Points on both rims of a cylinder along z around the origin [m], (2 count, 3)."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    ends = [
        np.column_stack([circle, np.full(count, z)]) for z in (-length / 2, length / 2)
    ]
    return np.vstack(ends)


def mesh_points(mesh: Path, scale: Sequence[float]) -> np.ndarray | None:
    """Vertices of a mesh, scaled [m], (P, 3); ``None`` if it cannot be read."""
    try:
        loaded = coal.MeshLoader().load(str(mesh), np.array(scale, dtype=float))
    except (ValueError, RuntimeError):
        return None
    return np.asarray(loaded.vertices())


def _hull(body: int, points: np.ndarray) -> list[Hull]:
    """The hull of the farthest points in evenly spread directions; none of flat shapes."""
    if len(points) < 4:
        return []
    farthest = np.unique(np.argmax(points @ directions(DIRECTIONS).T, axis=0))
    kept = points[farthest]
    try:
        hull = ConvexHull(kept)
    except QhullError:
        return []
    corners = hull.simplices
    outward = hull.equations[:, :3]
    a, b, c = (kept[corners[:, k]] for k in range(3))
    turned = np.einsum("fi,fi->f", np.cross(b - a, c - a), outward) < 0
    faces = corners.copy()
    faces[turned] = faces[turned][:, ::-1]
    return [Hull(body, kept, faces)]


def directions(count: int) -> np.ndarray:
    """Unit vectors spread evenly over the sphere, by the golden angle, shape (count, 3)."""
    k = np.arange(count) + 0.5
    height = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])


# Distance of an arm to itself and to the surface that it stands on, by the collision shapes of its URDF or boxes.


POSTURES = 1000
"""Random postures on which pairs that touch nearly always, or never come near, are found."""
OFTEN = 0.95
"""Pairs that touch in this share of them are no collision."""
FAR = 0.05
"""Pairs that stay farther apart than this in all of them are left to the final check of a search [m]."""
REMEDY = (
    "give the URDF beside its meshes, or leave collisions unchecked (--no-collisions)"
)
"""What to do about collision shapes that cannot be used."""


class CollisionModel:
    """Least distance between the bodies of an arm, meshes replaced by their convex hulls (which errs to the safe side).

    Bodies on the same joint or on neighbouring joints are left out, and so are pairs that touch in the zero posture
    or in nearly every posture: there the hulls overlap by construction. The surface is the plane z = height of the
    base frame, against which all moved bodies count. If shapes or meshes are missing, boxes of the bodies' mass and
    inertia stand in, with a ``ModelWarning``.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        height: of the surface in the base frame [m]; ``None`` if there is none.

    Attributes:
        pairs: names of the bodies compared, two each.
        left_out: pairs that touch by construction, two names each.

    Raises:
        InputError: a mesh cannot be read, or neither shapes nor inertials say how large the bodies are.
    """

    def __init__(
        self, arm: NominalArm, body: RigidBody, height: float | None = 0.0
    ) -> None:
        self._model, self._order = body.model, body.order
        self._shapes = _shapes(arm, self._model)
        bodies = self._shapes.ngeoms
        if height is not None:
            ground = coal.Halfspace(np.array([0.0, 0.0, 1.0]), float(height))
            self._shapes.addGeometryObject(
                pin.GeometryObject("surface", 0, 0, pin.SE3.Identity(), ground)
            )
        all_pairs = combinations(range(self._shapes.ngeoms), 2)
        self._set_pairs(
            [pair for pair in all_pairs if self._can_approach(*pair, bodies)]
        )
        candidates = self.pairs
        distances = self._sampled()
        overlapping = distances <= 0
        # hulls that overlap at zero or nearly always do so by construction
        by_construction = overlapping[0] | (overlapping[1:].mean(axis=0) >= OFTEN)
        self.left_out = tuple(compress(candidates, by_construction))
        kept = ~by_construction
        self._least = distances[:, kept].min(axis=0, initial=np.inf)
        self._keep(kept)

    def nearby(self, clearance: float) -> CollisionModel:
        """The same without pairs that stay ``FAR`` beyond a clearance [m] in random postures: faster, but a guess."""
        other = copy(self)
        other._shapes = self._shapes.copy()
        other._keep(self._least < clearance + FAR)
        return other

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least distance over all pairs and the pair it is met at.

        Args:
            q: joint positions in the arm's order [rad], shape (N, n).

        Returns:
            Distance [m], negative if bodies overlap, shape (N,), infinite if there are no pairs; and the place
            in ``pairs``, shape (N,).
        """
        q = np.ascontiguousarray(q[:, self._order])
        least, nearest = np.full(len(q), np.inf), np.zeros(len(q), dtype=int)
        if not self.pairs:
            return least, nearest
        for i in range(len(q)):
            nearest[i] = self._compute(q[i])
            least[i] = self._geometry.distanceResults[int(nearest[i])].min_distance
        return least, nearest

    def _compute(self, q: np.ndarray) -> int:
        """Compute the distances of all pairs at one posture, in kinematic order; the place of the nearest pair."""
        return int(
            pin.computeDistances(
                self._model, self._data, self._shapes, self._geometry, q
            )
        )

    def _can_approach(self, first: int, second: int, bodies: int) -> bool:
        """Whether two bodies can come near each other, by the joints that carry them."""
        shapes, parents = self._shapes.geometryObjects, self._model.parents
        a, b = int(shapes[first].parentJoint), int(shapes[second].parentJoint)
        if second >= bodies:  # the surface: only bodies that move can reach it
            return a > 0
        neighbours = parents[a] == b or parents[b] == a
        return a != b and not neighbours

    def _keep(self, chosen: np.ndarray) -> None:
        """Leave only some of the present pairs, bool per pair."""
        pairs = [(pair.first, pair.second) for pair in self._shapes.collisionPairs]
        self._set_pairs(list(compress(pairs, chosen)))

    def _set_pairs(self, pairs: list[tuple[int, int]]) -> None:
        self._shapes.removeAllCollisionPairs()
        for pair in pairs:
            self._shapes.addCollisionPair(pin.CollisionPair(*pair))
        self._data = self._model.createData()
        self._geometry = self._shapes.createData()
        names = [item.name for item in self._shapes.geometryObjects]
        self.pairs = tuple((names[a], names[b]) for a, b in pairs)

    def _sampled(self) -> np.ndarray:
        """Distance of the present pairs [m] in the zero posture and in random ones, one row each."""
        low = np.clip(self._model.lowerPositionLimit, -np.pi, np.pi)
        high = np.clip(self._model.upperPositionLimit, -np.pi, np.pi)
        zero = np.clip(np.zeros(self._model.nq), low, high)
        random = np.random.default_rng(0).uniform(
            low, np.maximum(low, high), (POSTURES, self._model.nq)
        )
        out = np.empty((POSTURES + 1, len(self.pairs)))
        for row, q in enumerate([zero, *random]):
            self._compute(q)
            results = self._geometry.distanceResults
            out[row] = [result.min_distance for result in results]
        return out


def _shapes(arm: NominalArm, model: pin.Model) -> pin.GeometryModel:
    """Collision shapes of a URDF, each convex, or boxes by the inertials if they are missing."""
    missing = "collision shapes are read from URDF files alone"
    if ET.parse(arm.urdf).getroot().tag == "robot":
        root = with_collision_shapes(arm.urdf, arm.joints)
        missing = _missing(root, arm.urdf)
        if not missing:
            return _urdf_shapes(arm, model, root)
    boxes = inertia_boxes(model)
    if boxes.ngeoms == 0:
        raise InputError(f"{missing}, and no body has a mass", REMEDY, file=arm.urdf)
    warnings.warn(
        f"{arm.urdf}: {missing}: collisions are checked with boxes of the bodies' mass and inertia, which real bodies "
        f"exceed in places; {REMEDY}, or keep a larger clearance",
        ModelWarning,
        stacklevel=3,
    )
    return boxes


def _missing(root: ET.Element, file: Path) -> str:
    """Why a robot file gives no collision shapes, or an empty string if it does."""
    shapes = root.findall("link/collision/geometry/*")
    if not shapes:
        return "it has no collision shapes"
    names = [s.get("filename", "") for s in shapes if s.tag == "mesh"]
    lost = [name for name in names if find_mesh(name, file) is None]
    return (
        f"{len(lost)} collision meshes are not found, first {lost[0]}" if lost else ""
    )


def _urdf_shapes(
    arm: NominalArm, model: pin.Model, root: ET.Element
) -> pin.GeometryModel:
    """Collision shapes of a URDF whose meshes are there, each convex."""
    for mesh in root.findall("link/collision/geometry/mesh"):
        file = find_mesh(mesh.get("filename", ""), arm.urdf)
        mesh.set("filename", "" if file is None else str(file.resolve()))
    text = ET.tostring(root, encoding="unicode")
    try:
        with parser_output(), warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", UserWarning
            )  # the binding warns of its own overload
            shapes = pin.buildGeomFromUrdfString(
                model, text, pin.GeometryType.COLLISION
            )
        for item in shapes.geometryObjects:
            if isinstance(item.geometry, coal.BVHModelBase):
                item.geometry.buildConvexHull(True, "Qt")
                item.geometry = item.geometry.convex
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"its collision shapes cannot be read ({error})", REMEDY, file=arm.urdf
        ) from None
    return shapes
