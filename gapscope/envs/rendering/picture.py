"""The picture of an episode: the arm, its reference as a ghost, and its error."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.envs.rendering.arm_view import ERROR_COLOUR, ArmView
from gapscope.envs.rendering.canvas import ARM, GHOST, GREY, INK, Canvas, blend
from gapscope.envs.rendering.charts import draw_errors, draw_joints, draw_tool_error
from gapscope.envs.rendering.scene import Scene

WIDTH, HEIGHT = 960, 560
"""Size of the picture [pixels]."""
TRAIL = 60
"""Actions for which the error of the tool is shown."""


class Picture:
    """Draws scenes of one arm."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._view = ArmView(kinematics, (20, 40, 540, 490))

    def begin(self, scene: Scene) -> None:
        """Prepare for a new episode."""
        self._view.begin(scene)

    def draw(self, scene: Scene) -> np.ndarray:
        """The scene as it is now, uint8, shape (``HEIGHT``, ``WIDTH``, 3)."""
        canvas = Canvas(WIDTH, HEIGHT)
        self._view.draw(canvas, scene)
        draw_errors(canvas, scene, (620, 66, 940, 270))
        draw_joints(canvas, scene, (590, 336, 940, 500))
        offset = self._tool_offset(scene)
        draw_tool_error(canvas, offset @ self._view.axes.T, (24, 372, 136, 484))
        self._label(canvas, scene, float(np.linalg.norm(offset[-1])))
        return canvas.pixels()

    def _tool_offset(self, scene: Scene) -> np.ndarray:
        """Tip minus reference of the tip in the last actions [m], shape (N, 3)."""
        rows = range(max(0, scene.now - TRAIL), scene.now + 1)
        skeleton = self._kinematics.skeleton
        return np.array(
            [
                skeleton(scene.q[row])[-1] - skeleton(scene.q_ref[row])[-1]
                for row in rows
            ]
        )

    def _label(self, canvas: Canvas, scene: Scene, offset: float) -> None:
        rms = 1e3 * float(np.sqrt(np.mean(np.square(scene.error))))
        canvas.text(16, 26, scene.title, INK, 16)
        facts = (
            f"t = {scene.period * scene.now:.2f} s",
            f"error so far {rms:.2f} mrad RMS",
        )
        canvas.text(
            16,
            46,
            "     ".join([*facts, f"tool off by {1e3 * offset:.2f} mm"]),
            INK,
            13,
        )
        canvas.capsule(np.array([24, 534]), np.array([38, 534]), 6, ARM)
        canvas.text(52, 534, "arm", GREY, 12, anchor="lm")
        canvas.capsule(
            np.array([104, 534]), np.array([118, 534]), 6, blend(GHOST, 0.55)
        )
        canvas.text(132, 534, "reference and its way", GREY, 12, anchor="lm")
        canvas.line(np.array([[278, 534], [296, 534]]), ERROR_COLOUR, 2.5)
        canvas.text(304, 534, "error of the tool", GREY, 12, anchor="lm")
        if scene.ending:
            canvas.text(590, 526, scene.ending, ERROR_COLOUR, 12)
