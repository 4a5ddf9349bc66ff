"""Shapes of links, their convex hulls, and collisions between them."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations, compress, product
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from gapscope.arm.dynamics.description import Shape, read_description
from gapscope.arm.dynamics.inertials import inertia_boxes
from gapscope.arm.dynamics.kinematics import POSTURES
from gapscope.arm.dynamics.rigid_body import FORMS, RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import MOST

# Shapes and named frames of a robot file, placed on the bodies that move them.


class Frame(NamedTuple):
    """A link of a robot file as a frame on a moving body.

    Attributes:
        name: of the link.
        joint: name of the joint that moves it, or an empty string for the base.
        place: of the link's frame in that joint's frame.
    """

    name: str
    joint: str
    place: pin.SE3


@dataclass(frozen=True)
class PlacedShape(Shape):
    """A visual or collision shape on a moving body, in whose joint's frame its place is.

    Attributes:
        link: its name.
        joint: that moves the body, or an empty string for the base.
    """

    link: str = ""
    joint: str = ""


def read_frames(body: RigidBody) -> dict[str, Frame]:
    """Links of the file by name, those that are fixed to a moving body with their place on it."""
    joints = ["", *list(body.model.names)[1:]]
    return {
        frame.name: Frame(frame.name, joints[frame.parentJoint], frame.placement.copy())
        for frame in body.model.frames
        if frame.type == pin.FrameType.BODY
    }


def read_shapes(
    body: RigidBody,
) -> tuple[tuple[PlacedShape, ...], tuple[str, ...]]:
    """Shapes of the URDF, and a sentence for each that cannot be used; nothing of an MJCF file."""
    description = read_description(body.file)
    if description.form != "URDF":
        return (), ("shapes: they are read from URDF files alone",)
    frames = read_frames(body)
    shapes, notes = [], []
    for link in description.links:
        frame = frames.get(link.name)
        for shape in link.drawn:
            if frame is None or shape.lost or not shape.size:
                said = "it has no known geometry"
                if shape.kind == "mesh":
                    said = f"the mesh {shape.named} is not found"
                notes.append(f"a {shape.use} shape of link {link.name}: {said}")
                continue
            # the shape's place on the body: through the frame of its link
            own = vars(shape) | {"place": frame.place * shape.place}
            shapes.append(PlacedShape(**own, link=link.name, joint=frame.joint))
    # once, though several shapes may name the same mesh
    return tuple(shapes), tuple(dict.fromkeys(notes))


# Convex hulls of an arm's moving bodies, few triangles each, for pictures.


DIRECTIONS = 150
"""Directions in which the farthest point of a body is kept."""
THICKNESS = 0.03
"""Radius of a rod over the length of the stretched arm [1]."""


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
    found, model = list[Hull](), body.model
    # visual shapes first; collision ones only of bodies that have none
    for use in ("visual", "collision"):
        drawn = {hull.body for hull in found}
        for shape in shapes:
            number = model.getJointId(shape.joint) if shape.joint else 0
            if shape.use == use and number not in drawn:
                # a picture can do without a mesh that cannot be read
                points = shape_points(shape, DIRECTIONS, DIRECTIONS)
                if points is not None:
                    turned = points @ shape.place.rotation.T
                    found += _hull(number, turned + shape.place.translation)
    drawn = {hull.body for hull in found}
    # a rod is the hull of a ball at either end
    ball = THICKNESS * reach(body) * directions(DIRECTIONS)
    for number in range(model.njoints):
        if number in drawn:
            continue
        # nothing is drawn of it: rods to the joints that it carries, of the last to its centre of mass
        carried = [k for k in range(1, model.njoints) if model.parents[k] == number]
        ends = [model.jointPlacements[k].translation for k in carried]
        for end in ends or [model.inertias[number].lever]:
            found += _hull(number, np.vstack([ball, ball + end]))
    return tuple(found)


def reach(body: RigidBody) -> float:
    """Length of the stretched arm [m]."""
    places = list(body.model.jointPlacements)[1:]
    return float(sum(np.linalg.norm(place.translation) for place in places))


def shape_points(shape: Shape, count: int, corners: int) -> np.ndarray | None:
    """Points whose hull is that of a shape, in its frame [m], (P, 3).

    Args:
        shape: the shape.
        count: of points on a ball.
        corners: of a circle.

    Returns:
        The points; ``None`` of a shape without size, or a mesh that cannot be read.
    """
    size = np.array(shape.size)
    if shape.kind == "mesh":
        return None if shape.mesh is None else mesh_points(shape.mesh, shape.size)
    if not (size > 0).all():
        return None
    if shape.kind == "box":
        return 0.5 * size * np.array(list(product((-1, 1), repeat=3)))
    if shape.kind == "cylinder":
        angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
        rim = size[0] * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    elif shape.kind == "capsule":
        rim = directions(count) * size[0]
    else:
        return directions(count) * size
    # cylinder and capsule are the hull of their two ends
    end = np.array([0.0, 0.0, size[1] / 2])
    return np.vstack([rim - end, rim + end])


def mesh_points(mesh: Path, scale: Sequence[float]) -> np.ndarray | None:
    """Vertices of a mesh, scaled [m], (P, 3); ``None`` if it cannot be read."""
    try:
        loaded = coal.MeshLoader().load(str(mesh), np.array(scale, dtype=float))
    except (ValueError, RuntimeError):
        return None
    return loaded.vertices()


def _hull(body: int, points: np.ndarray) -> list[Hull]:
    """The hull of the farthest points in evenly spread directions; none of flat shapes."""
    if len(points) <= points.shape[1]:
        return []
    # few corners draw fast, and the hull of the farthest points hides little
    kept = points[np.unique(np.argmax(points @ directions(DIRECTIONS).T, axis=0))]
    try:
        hull = ConvexHull(kept)
    except QhullError:
        return []
    corners = hull.simplices
    outward = hull.equations[:, :3]
    a, b, c = (kept[corners[:, k]] for k in range(3))
    # SciPy gives corners in no order: the normal that they make must point outwards
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


FAR = 0.05
"""Pairs that stay farther apart than this in all random postures are left to the final check of a search [m]."""
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
        self._shapes = _collision_shapes(arm, body)
        bodies = self._shapes.ngeoms
        if height is not None:
            # all that lies below the height is solid
            ground = coal.Halfspace(np.array([0.0, 0.0, 1.0]), float(height))
            self._shapes.addGeometryObject(
                pin.GeometryObject("surface", 0, 0, pin.SE3.Identity(), ground)
            )
        # bodies on other joints than the same or neighbouring ones; the surface only bodies that move can reach
        on = [int(shape.parentJoint) for shape in self._shapes.geometryObjects]
        above, apart = self._model.parents, []
        for (first, a), (second, b) in combinations(enumerate(on), 2):
            beside = a == b or above[a] == b or above[b] == a
            if a > 0 if second >= bodies else not beside:
                apart.append((first, second))
        self._set_pairs(apart)
        candidates = self.pairs
        # which pairs touch by construction, and how near others come
        distances = self._sampled()
        overlapping = distances <= 0
        # hulls that overlap at zero or nearly always do so by construction
        by_construction = overlapping[0] | (overlapping[1:].mean(axis=0) >= MOST)
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
        # one posture at a time: pinocchio has no series of distances
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
        model, out = self._model, []
        limits = (model.lowerPositionLimit, model.upperPositionLimit)
        # joints without limits within a turn
        low, high = np.clip(limits, -np.pi, np.pi)
        zero = np.clip(np.zeros(model.nq), low, high)
        size, high = (POSTURES, model.nq), np.maximum(low, high)
        for q in (zero, *np.random.default_rng(0).uniform(low, high, size)):
            self._compute(q)
            out.append([x.min_distance for x in self._geometry.distanceResults])
        return np.array(out).reshape(POSTURES + 1, len(self.pairs))


def _collision_shapes(arm: NominalArm, body: RigidBody) -> pin.GeometryModel:
    """Collision shapes of a URDF, each convex, or boxes by the inertials if they are missing."""
    description, frames = read_description(arm.urdf), read_frames(body)
    links = [link for link in description.links if link.name in frames]
    drawn = [x for link in links for x in link.drawn if x.use == "collision"]
    lost = [shape.named for shape in drawn if shape.lost]
    # without <geometry> nothing is drawn
    strange = [x.kind for x in drawn if not x.size and x.kind != x.use]
    missing = "" if drawn else "it has no collision shapes"
    if description.form != "URDF":
        missing = "collision shapes are read from URDF files alone"
    elif lost:
        missing = f"{len(lost)} collision meshes are not found, first {lost[0]}"
    elif strange:
        missing = f"a collision shape is a <{strange[0]}>, which is not read"
    # boxes by mass and inertia only if shapes cannot be had, all of them
    if not missing:
        shapes = [x for x in read_shapes(body)[0] if x.use == "collision"]
        return _convex(shapes, body, arm.urdf)
    boxes = inertia_boxes(body.model)
    if boxes.ngeoms == 0:
        raise InputError(f"{missing}, and no body has a mass", REMEDY, file=arm.urdf)
    warnings.warn(
        f"{arm.urdf}: {missing}: collisions are checked with boxes of the bodies' mass and inertia, which real bodies "
        f"exceed in places; {REMEDY}, or keep a larger clearance",
        ModelWarning,
        stacklevel=3,
    )
    return boxes


def _convex(
    shapes: Sequence[PlacedShape], body: RigidBody, file: Path
) -> pin.GeometryModel:
    """Shapes of a URDF, each convex, named after their links with a number."""
    found = pin.GeometryModel()
    count: Counter[str] = Counter()
    for shape in shapes:
        if shape.kind == "mesh":
            try:
                form = coal.MeshLoader().load(str(shape.mesh), np.array(shape.size))
                # a hull is convex, so that distances are exact, and encloses the mesh
                form.buildConvexHull(True, "Qt")
            except (ValueError, RuntimeError) as error:
                raise InputError(
                    f"its collision shapes cannot be read ({error})", REMEDY, file=file
                ) from None
            form = form.convex
        else:
            form = FORMS[shape.kind](*shape.size)
        parent = body.model.getJointId(shape.joint) if shape.joint else 0
        name = f"{shape.link}_{count[shape.link]}"
        found.addGeometryObject(
            pin.GeometryObject(name, parent, parent, shape.place, form)
        )
        count[shape.link] += 1
    return found
