"""The charts beside the arm: tracking error over time, torque, and the error of the tool magnified."""

from __future__ import annotations

import numpy as np

from gapscope.envs.rendering.canvas import (
    FAINT,
    GHOST,
    GREY,
    INK,
    JOINT_COLOURS,
    Canvas,
    blend,
)
from gapscope.envs.rendering.scene import Scene

Area = tuple[float, float, float, float]
"""Left, top, right and bottom [pixels]."""


def draw_errors(canvas: Canvas, scene: Scene, area: Area) -> None:
    """Tracking error of each joint over the whole episode [mrad]."""
    left, top, right, bottom = area
    errors = 1e3 * np.array(scene.error)
    span = _round_up(max(float(np.abs(errors).max()), 0.1))
    canvas.text(left, top - 8, "tracking error, mrad", INK, 13)
    canvas.box(left, top, right, bottom, None, FAINT)
    duration = scene.period * (len(scene.q_ref) - 1)
    for level in (-span, -span / 2, 0.0, span / 2, span):
        y = (top + bottom) / 2 - level / span * (bottom - top) / 2
        canvas.line(np.array([[left, y], [right, y]]), GREY if level == 0 else FAINT)
        canvas.text(left - 5, y, f"{level:g}", GREY, 10, anchor="rm")
    for time in np.linspace(0, duration, 6):
        x = left + (right - left) * time / duration
        canvas.text(
            x,
            bottom + 14,
            f"{time:.3g}" + (" s" if time == duration else ""),
            GREY,
            10,
            anchor="ms",
        )
    columns = left + (right - left) * np.arange(len(errors)) / max(
        len(scene.q_ref) - 1, 1
    )
    for joint in range(errors.shape[1]):
        heights = (top + bottom) / 2 - errors[:, joint] / span * (bottom - top) / 2
        canvas.line(
            np.column_stack([columns, heights]),
            JOINT_COLOURS[joint % len(JOINT_COLOURS)],
            1.6,
        )


def draw_joints(canvas: Canvas, scene: Scene, area: Area) -> None:
    """Per joint its colour, its present error [mrad], and its commanded torque over the rated torque as a bar."""
    left, top, right, bottom = area
    count = len(scene.load)
    middle, half = left + 0.64 * (right - left), 0.22 * (right - left)
    canvas.text(left, top - 8, "joint", INK, 13)
    canvas.text(
        left + 0.32 * (right - left), top - 8, "error, mrad", INK, 13, anchor="rs"
    )
    canvas.text(middle, top - 8, "torque / rated", INK, 13, anchor="ms")
    pitch = min((bottom - top) / count, 22.0)
    for joint, (load, error) in enumerate(
        zip(scene.load, scene.error[-1], strict=True)
    ):
        y, colour = (
            top + (joint + 0.6) * pitch,
            JOINT_COLOURS[joint % len(JOINT_COLOURS)],
        )
        canvas.disc(np.array([left + 6, y]), 4.5, colour)
        canvas.text(left + 16, y, str(joint + 1), INK, 12, anchor="lm")
        canvas.text(
            left + 0.32 * (right - left),
            y,
            f"{round(1e3 * float(error), 2) + 0.0:+.2f}",
            INK,
            12,
            anchor="rm",
        )
        tip = middle + half * float(np.clip(load, -1, 1))
        canvas.box(
            min(middle, tip),
            y - 0.28 * pitch,
            max(middle, tip),
            y + 0.28 * pitch,
            blend(colour, 0.3),
            None,
        )
        canvas.text(
            right, y, f"{round(float(load), 2) + 0.0:+.2f}", GREY, 10, anchor="rm"
        )
    for mark in (middle - half, middle, middle + half):
        canvas.line(
            np.array([[mark, top], [mark, top + count * pitch]]),
            GREY if mark == middle else FAINT,
        )


def draw_tool_error(canvas: Canvas, offset: np.ndarray, area: Area) -> None:
    """Where the tool is beside where it should be, across the line of sight; what is along it is written below.

    Args:
        canvas: to draw on.
        offset: right, up and towards the eye [m], shape (N, 3), last is now.
        area: of the circle.
    """
    depth, offset = 1e3 * float(offset[-1, 2]), offset[:, :2]
    left, top, right, bottom = area
    centre = np.array([(left + right) / 2, (top + bottom) / 2])
    radius = (right - left) / 2
    span = _round_up(max(1.1e3 * float(np.linalg.norm(offset[-1])), 0.1))
    canvas.disc(centre, radius, (255, 255, 255), outline=GREY)
    canvas.disc(centre, radius / 2, (255, 255, 255), outline=FAINT)
    for way in (np.array([radius, 0.0]), np.array([0.0, radius])):
        canvas.line(np.array([centre - way, centre + way]), FAINT)
    pixels = centre + 1e3 * offset / span * radius * np.array([1.0, -1.0])
    pixels = pixels[np.linalg.norm(pixels - centre, axis=1) < radius]
    canvas.line(pixels, (235, 150, 155), 1.5)
    canvas.disc(centre, 4, GHOST, outline=INK)
    if len(pixels):
        canvas.disc(pixels[-1], 4, (200, 30, 45), outline=INK)
    canvas.text(
        left - 8, bottom + 14, f"tool as seen, circle of {span:g} mm;", GREY, 11
    )
    canvas.text(
        left - 8,
        bottom + 27,
        f"{abs(depth):.1f} mm {'nearer' if depth > 0 else 'farther'}",
        GREY,
        11,
    )


def _round_up(value: float) -> float:
    """The next of 1, 2, 3, 4, 6, 8, 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(
        next(
            step * power
            for step in (1, 2, 3, 4, 6, 8, 10)
            if step * power >= value * (1 - 1e-9)
        )
    )
