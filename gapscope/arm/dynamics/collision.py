"""Distance of an arm to itself and to the surface that it stands on, by the collision shapes of its URDF or boxes."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from copy import copy
from itertools import combinations, compress
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.inertia_boxes import inertia_boxes
from gapscope.arm.dynamics.link_shapes import find_mesh
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import parser_output, with_collision_shapes
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.nominal import NominalArm

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
