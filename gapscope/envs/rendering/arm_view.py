"""The arm in space: its links as capsules, its reference as a ghost behind it, the way of the tool."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.envs.rendering.canvas import (
    ARM,
    FAINT,
    GHOST,
    GREY,
    INK,
    Canvas,
    Colour,
    blend,
)
from gapscope.envs.rendering.scene import Scene

AZIMUTH, ELEVATION = np.deg2rad(-55.0), np.deg2rad(20.0)
"""Direction that the camera looks from: about z from x on, and above the ground [rad]."""
PATH_POINTS = 120
"""Points of the tool's way that are drawn."""
ERROR_COLOUR: Colour = (200, 30, 45)


class ArmView:
    """Draws a scene in a rectangle of the canvas, seen in parallel from a fixed direction, at a scale per episode.

    Args:
        kinematics: of the arm.
        area: left, top, width and height [pixels].
    """

    def __init__(
        self, kinematics: Kinematics, area: tuple[float, float, float, float]
    ) -> None:
        self._kinematics, self._area = kinematics, area
        ca, sa, ce, se = (
            np.cos(AZIMUTH),
            np.sin(AZIMUTH),
            np.cos(ELEVATION),
            np.sin(ELEVATION),
        )
        self._axes = np.array(
            [[-sa, ca, 0.0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]]
        )

    @property
    def axes(self) -> np.ndarray:
        """Right, up and towards the eye, in the base frame, shape (3, 3)."""
        return self._axes

    def begin(self, scene: Scene) -> None:
        """Compute the way of the tool, and a scale at which the whole motion fits."""
        rows = np.unique(
            np.linspace(0, len(scene.q_ref) - 1, PATH_POINTS).round().astype(int)
        )
        bones = np.array([self._kinematics.skeleton(q) for q in scene.q_ref[rows]])
        self._path, self._rows = bones[:, -1], rows
        self._reach = max(float(np.abs(bones).max()), 1e-3)
        ground = self._ground()
        flat = np.vstack([bones.reshape(-1, 3), ground]) @ self._axes[:2].T
        low, high = flat.min(axis=0), flat.max(axis=0)
        _, _, width, height = self._area
        self._scale = 0.86 * min(
            width / (high - low)[0], height / (high - low)[1]
        )  # the ground is never a point
        self._middle = (low + high) / 2

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw ground, way of the tool, ghost, arm, and the error of the tool."""
        flat = self._projection()
        self._draw_ground(canvas, flat)
        canvas.line(flat(self._path), blend(GHOST, 0.6), 1.2)
        canvas.line(flat(self._path[self._rows <= scene.now]), GHOST, 2.0)
        actual, wanted = (
            self._kinematics.skeleton(q) for q in (scene.q[-1], scene.q_ref[scene.now])
        )
        self._draw_arm(canvas, wanted, flat, blend(GHOST, 0.55), halo=5.0)
        self._draw_arm(canvas, actual, flat, ARM, halo=0.0)
        tools = flat(np.array([actual[-1], wanted[-1]]))
        canvas.line(tools, ERROR_COLOUR, 2.5)
        canvas.disc(tools[1], 4, GHOST, outline=INK)
        canvas.disc(tools[0], 3, ERROR_COLOUR)

    def _projection(self) -> Callable[[np.ndarray], np.ndarray]:
        left, top, width, height = self._area
        centre = np.array([left + width / 2, top + height / 2])

        def flat(points: np.ndarray) -> np.ndarray:
            """Pixels of points in the base frame [m], shape (N, 2)."""
            return centre + (
                points @ self._axes[:2].T - self._middle
            ) * self._scale * np.array([1.0, -1.0])

        return flat

    def _ground(self) -> np.ndarray:
        """Corners of a square of ground around the base [m], shape (4, 3)."""
        side = 0.7 * self._reach
        return side * np.array(
            [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float
        )

    def _draw_ground(
        self, canvas: Canvas, flat: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        side = 0.7 * self._reach
        for place in np.linspace(-side, side, 8):
            for ends in (
                [[place, -side, 0], [place, side, 0]],
                [[-side, place, 0], [side, place, 0]],
            ):
                canvas.line(flat(np.array(ends)), FAINT, 1.0)

    def _draw_arm(
        self,
        canvas: Canvas,
        bones: np.ndarray,
        flat: Callable[[np.ndarray], np.ndarray],
        colour: Colour,
        halo: float,
    ) -> None:
        """Links from far to near, thinner towards the tool; a ghost is wider by its halo and has no edges."""
        points, depth = flat(bones), bones @ self._axes[2]
        widths = np.linspace(0.052, 0.022, len(bones)) * self._reach * self._scale
        order = np.argsort(np.maximum(depth[:-1], depth[1:]))
        for link in order:
            start, end, radius = points[link], points[link + 1], widths[link]
            if halo:
                canvas.capsule(start, end, radius + halo, colour)
                continue
            canvas.capsule(start, end, radius + 1.2, INK)
            canvas.capsule(start, end, radius, colour)
            shine = np.array([-0.3, -0.35]) * radius
            canvas.capsule(
                start + shine, end + shine, 0.25 * radius, blend(colour, 0.45)
            )
            if link > 0:
                canvas.disc(start, 0.62 * radius, blend(colour, 0.75, INK), outline=INK)
        if not halo:
            base = points[0]
            canvas.text(
                base[0], base[1] + widths[0] + 16, "base", GREY, 11, anchor="ms"
            )
