"""What is found in a robot's model, and how large its links are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gapscope.arm.dynamics.description import Description
from gapscope.arm.dynamics.link_shapes import mesh_points, shape_points
from gapscope.arm.input_file import is_folder
from gapscope.arm.io.case_file import CasePaths, is_case, read_case_file
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
    rank = SEVERITIES.index
    return tuple(
        sorted(findings, key=lambda one: (rank(one.severity), -one.size, one.line))
    )


# How large a link is: the convex hulls of its shapes.


DIRECTIONS = 200
"""Points on a round surface; its hull is some 2 % smaller than the body."""
CORNERS = 48
"""Points on the rim of a cylinder."""


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
    shapes = []
    for other, place in description.rigid_part(link):
        if other.name != link and other.inertial is not None:
            continue
        if other.lost:
            return None  # the shapes that are left may be a small part of the link
        for shape in other.shapes:
            if shape.kind == "mesh" and shape.mesh is not None:
                corners = _mesh(shape.mesh, shape.size, shape.mesh.stat().st_mtime_ns)
                if corners is None:
                    return None
            else:
                corners = shape_points(shape, DIRECTIONS, CORNERS)
            if corners is not None:
                pose = place * shape.place
                shapes.append((shape, corners @ pose.rotation.T + pose.translation))
    # casings are drawn twice, for the eye and for contacts: one of them is the body
    every = [points for _, points in shapes]
    collisions = [points for shape, points in shapes if shape.use == "collision"]
    hulls = [hull for points in collisions or every if (hull := _hull(points))]
    whole = _hull(np.vstack(every)) if shapes else None
    if not hulls or whole is None:
        return None
    volume, centre, variance = _solid(hulls)
    corners = whole.points[whole.vertices]
    edge = float(np.ptp(corners, axis=0).max())
    # overlapping shapes may add up to more than the hull of all
    return Geometry(corners, min(volume, whole.volume), centre, variance, edge)


def distance_outside(geometry: Geometry, point: np.ndarray) -> float:
    """How far a point lies beyond the planes of the hull [m], at least; 0 inside."""
    # planes of the hull: n x + d > 0 outside, with n of length one
    equations = ConvexHull(geometry.points).equations
    return float(max(0.0, (equations[:, :3] @ point + equations[:, 3]).max()))


def _hull(points: np.ndarray) -> ConvexHull | None:
    """Convex hull of points; ``None`` if they are flat."""
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _solid(hulls: Sequence[ConvexHull]) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume [m^3], centre [m] and variance [m^2] of the bodies within hulls together, by tetrahedra.

    With the corners p_i of a side and a point inside, each has the volume V = |det(p_i - p_4)| / 6 and the second
    moment V/20 (sum p_i p_i^T + (sum p_i)(sum p_i)^T).
    """
    parts = []
    for hull in hulls:
        sides = hull.points[hull.simplices]
        # from a point inside, so that all tetrahedra count with the same sign
        inside = np.broadcast_to(hull.points[hull.vertices].mean(axis=0), sides.shape)
        parts.append(np.concatenate([sides, inside[:, :1]], axis=1))
    corners = np.concatenate(parts)
    volumes = np.abs(np.linalg.det(corners[:, :3] - corners[:, 3:])) / 6
    total, sums = volumes.sum(), corners.sum(axis=1)
    centre = volumes @ sums / 4 / total
    second = np.einsum("t,tki,tkj->ij", volumes / 20, corners, corners)
    second += np.einsum("t,ti,tj->ij", volumes / 20, sums, sums)
    return float(total), centre, second / total - np.outer(centre, centre)


@lru_cache(maxsize=256)
def _mesh(path: Path, scale: tuple[float, ...], written: int) -> np.ndarray | None:
    """Corners of a mesh's hull [m], of a file as it was written at a time; ``None`` if it cannot be read."""
    points = mesh_points(path, scale)
    hull = None if points is None else _hull(points)
    # the hull's corners alone: a mesh may have a hundred thousand
    return None if hull is None else hull.points[hull.vertices]


# The robot file behind a path, a known name or a case, without building the robot.


def find_robot(robot: str | Path) -> tuple[Path, Path | None, Mapping[str, Any]]:
    """The URDF or MJCF file of a robot, which is given by its path, a known name, a case folder or its case file.

    Beside it the case file and what stands in it, or ``None`` and nothing.

    Raises:
        InputError: there is none.
    """
    path = Path(robot)
    if not is_case(path):
        return locate(robot, Path())[0], None, {}
    file = path / "case.yaml" if is_folder(path) else path
    content = read_case_file(file)
    named = CasePaths(file, None).expand(content["robot"], "robot")
    return locate(named, file.parent)[0], file, content
