"""Convex hulls of an arm's moving bodies, few triangles each, for pictures."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gapscope.arm.dynamics.link_shapes import Shape, read_shapes
from gapscope.arm.dynamics.rigid_body import RigidBody

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
            ball = thickness * _directions()
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
        return _corners(np.array(shape.size))
    if shape.kind == "sphere":
        return shape.size[0] * _directions()
    if shape.kind == "cylinder":
        radius, length = shape.size
        return _cylinder(radius, length)
    return _mesh_points(shape)


def _corners(edges: np.ndarray) -> np.ndarray:
    """Corners of a box around the origin, (8, 3)."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return 0.5 * signs * edges


def _cylinder(radius: float, length: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    ends = [
        np.column_stack([circle, np.full(ROUND, z)]) for z in (-length / 2, length / 2)
    ]
    return np.vstack(ends)


def _mesh_points(shape: Shape) -> np.ndarray:
    """Vertices of a mesh, scaled, (P, 3); none if it cannot be read."""
    if shape.mesh is None:
        return np.empty((0, 3))
    try:
        mesh = coal.MeshLoader().load(
            str(shape.mesh), np.array(shape.size, dtype=float)
        )
    except (ValueError, RuntimeError):
        # a picture can do without: the body is drawn as a box
        return np.empty((0, 3))
    return np.asarray(mesh.vertices())


def _hull(body: int, points: np.ndarray) -> list[Hull]:
    """The hull of the farthest points in evenly spread directions; none of flat shapes."""
    if len(points) < 4:
        return []
    farthest = np.unique(np.argmax(points @ _directions().T, axis=0))
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


def _directions() -> np.ndarray:
    """Unit vectors spread evenly over the sphere, by the golden angle, shape (DIRECTIONS, 3)."""
    k = np.arange(DIRECTIONS) + 0.5
    height = 1 - 2 * k / DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
