"""Pictures of a tracked arm, drawn from its kinematics: alike on every engine, with and without a display."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rich.control import Control
from rich.style import Style
from rich.text import Text

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.arm.nearest_name import check_known


@dataclass
class Scene:
    """One episode, n joints; grows with every action.

    Attributes:
        title: robot and effects.
        period: time between actions [s].
        q_ref: reference at every action [rad], shape (K + 1, n).
        q: true positions so far [rad], each (n,).
        error: reference minus encoders so far [rad], each (n,).
        load: commanded over rated torque at last [1], shape (n,).
        ending: why the episode ended early, or nothing.
    """

    title: str
    period: float
    q_ref: np.ndarray
    q: list[np.ndarray] = field(default_factory=list)
    error: list[np.ndarray] = field(default_factory=list)
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ending: str = ""

    @property
    def now(self) -> int:
        """Number of actions done."""
        return len(self.q) - 1


Colour = tuple[int, int, int]

FINE = 2
"""Pixels that are drawn per pixel of the picture, in each direction."""
PAPER: Colour = (250, 250, 247)
INK: Colour = (38, 42, 48)
FAINT: Colour = (214, 216, 216)
GREY: Colour = (120, 125, 130)
ARM: Colour = (240, 146, 56)
"""Colour of the arm itself."""
GHOST: Colour = (70, 130, 200)
"""Colour of the reference."""
JOINT_COLOURS: tuple[Colour, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (120, 94, 240),
    (150, 130, 0),
    (86, 180, 233),
    (90, 90, 90),
)
"""Colours of joints 1, 2, ..., distinguished by colour-blind eyes too; the ninth is the first again."""


class Canvas:
    """A picture under construction; coordinates and widths in its pixels, origin at the top left."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._image = Image.new("RGB", (width * FINE, height * FINE), PAPER)
        self._draw = ImageDraw.Draw(self._image)

    def pixels(self) -> np.ndarray:
        """The picture, uint8, shape (height, width, 3)."""
        return np.asarray(self._image.reduce(FINE))

    def line(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """A line through points of shape (N, 2)."""
        if len(points) > 1:
            self._draw.line(
                _fine(points),
                fill=colour,
                width=max(1, round(width * FINE)),
                joint="curve",
            )

    def disc(
        self,
        centre: np.ndarray,
        radius: float,
        colour: Colour,
        outline: Colour | None = None,
    ) -> None:
        """A filled circle, with a line of one pixel around it if ``outline`` is given."""
        x, y = np.asarray(centre) * FINE
        r = radius * FINE
        self._draw.ellipse(
            (x - r, y - r, x + r, y + r), fill=colour, outline=outline, width=FINE
        )

    def capsule(
        self, start: np.ndarray, end: np.ndarray, radius: float, colour: Colour
    ) -> None:
        """A thick line with round ends."""
        self.line(np.array([start, end]), colour, 2 * radius)
        self.disc(start, radius, colour)
        self.disc(end, radius, colour)

    def box(
        self,
        left: float,
        top: float,
        right: float,
        bottom: float,
        fill: Colour | None,
        edge: Colour | None,
    ) -> None:
        """A rectangle."""
        self._draw.rectangle(
            [v * FINE for v in (left, top, right, bottom)],
            fill=fill,
            outline=edge,
            width=FINE,
        )

    def text(
        self,
        x: float,
        y: float,
        text: str,
        colour: Colour = INK,
        size: int = 12,
        anchor: str = "ls",
    ) -> None:
        """Text, by default with its left end on the baseline at (x, y); anchors as in Pillow."""
        self._draw.text(
            (x * FINE, y * FINE),
            text,
            fill=colour,
            font=_font(size * FINE),
            anchor=anchor,
        )


def blend(colour: Colour, share: float, other: Colour = PAPER) -> Colour:
    """A colour with a share of another [1]."""
    return tuple(round(a + share * (b - a)) for a, b in zip(colour, other, strict=True))  # type: ignore[return-value]


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _fine(points: np.ndarray) -> list[tuple[float, float]]:
    return [(float(x) * FINE, float(y) * FINE) for x, y in points]


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
    for t in np.linspace(0, duration, 6):
        x = left + (right - left) * t / duration
        canvas.text(
            x,
            bottom + 14,
            f"{t:.3g}" + (" s" if t == duration else ""),
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


TERMINAL_PERIOD = 0.5
"""Pictures in the terminal are at least this far apart [s]."""
TERMINAL_COLUMNS, TERMINAL_ROWS = 80, 24
"""Size of a picture in the terminal [characters]; each character shows two pixels, one above the other."""


class Viewer(Protocol):
    """Shows pictures."""

    def show(self, picture: np.ndarray, caption: str) -> None:
        """Show a picture, uint8, shape (height, width, 3), with a line of text if pictures are coarse."""

    def close(self) -> None:
        """Stop showing."""


def open_viewer(title: str, period: float) -> Viewer:
    """A window if there is a display and Tk, else the terminal; a picture every ``period`` seconds at most."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        return TerminalViewer()
    try:
        import tkinter
    except ImportError:
        return TerminalViewer()
    try:
        return WindowViewer(tkinter, title, period)
    except tkinter.TclError:
        return TerminalViewer()


class WindowViewer:
    """A window of Tk; waits so that pictures follow each other in real time."""

    def __init__(self, tkinter: Any, title: str, period: float) -> None:
        self._tkinter, self._period, self._due = tkinter, period, 0.0
        self._window = tkinter.Tk()
        self._window.title(title)
        self._label = tkinter.Label(self._window, borderwidth=0)
        self._label.pack()
        self._open = True
        self._window.protocol("WM_DELETE_WINDOW", self.close)

    def show(self, picture: np.ndarray, caption: str) -> None:
        """Show a picture; does nothing once the window was closed."""
        if not self._open:
            return
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + self._period
        height, width, _ = picture.shape
        data = b"P6 %d %d 255 " % (width, height) + picture.tobytes()
        self._image = self._tkinter.PhotoImage(
            master=self._window, data=data, format="PPM"
        )
        self._label.configure(image=self._image)
        self._window.update()

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        if self._open:
            self._open = False
            self._window.destroy()


class TerminalViewer:
    """Coloured half blocks in a terminal, and the caption alone if the output is no terminal."""

    def __init__(self, console: Console | None = None) -> None:
        self._console, self._due = console or Console(), 0.0

    def show(self, picture: np.ndarray, caption: str) -> None:
        """Show a picture over the one before, if that is ``TERMINAL_PERIOD`` old."""
        if time.monotonic() < self._due:
            return
        if self._console.is_terminal:
            if self._due:
                self._console.control(Control.move(0, -(TERMINAL_ROWS + 1)))
            self._console.print(_half_blocks(picture), end="")
        self._console.print(caption, highlight=False, overflow="crop", no_wrap=True)
        self._due = time.monotonic() + TERMINAL_PERIOD

    def close(self) -> None:
        """Nothing stays open."""


def _half_blocks(picture: np.ndarray) -> Text:
    """A picture as characters whose upper and lower half have the colour of a pixel each."""
    height, width, _ = picture.shape
    rows = np.linspace(0, height, 2 * TERMINAL_ROWS + 1).astype(int)[:-1]
    columns = np.linspace(0, width, TERMINAL_COLUMNS + 1).astype(int)[:-1]
    sums = np.add.reduceat(
        np.add.reduceat(picture.astype(float), rows, axis=0), columns, axis=1
    )
    counts = np.diff(np.r_[rows, height])[:, None] * np.diff(np.r_[columns, width])
    coarse = (sums / counts[:, :, None]).astype(int)
    text = Text()
    for upper, lower in zip(coarse[::2], coarse[1::2], strict=True):
        for above, below in zip(upper, lower, strict=True):
            colours = (
                f"rgb({','.join(map(str, colour))})" for colour in (above, below)
            )
            text.append("▀", Style.parse(" on ".join(colours)))
        text.append("\n")
    return text


MODES = ("human", "rgb_array")


class Screen:
    """Pictures of one environment's episodes.

    Args:
        kinematics: of the arm.
        mode: ``human`` or ``rgb_array``.
        period: time between actions [s].

    Raises:
        InputError: unknown mode.
    """

    def __init__(self, kinematics: Kinematics, mode: str, period: float) -> None:
        self._mode, self._period = (
            check_known("render mode", mode, MODES, where="render_mode"),
            period,
        )
        self._picture = Picture(kinematics)
        self._scene: Scene | None = None
        self._viewer: Viewer | None = None

    def begin(self, title: str, q_ref: np.ndarray) -> None:
        """Begin an episode with its reference at every action [rad], shape (K + 1, n)."""
        self._scene = Scene(title, self._period, q_ref)
        self._picture.begin(self._scene)

    def add(
        self, q: np.ndarray, error: np.ndarray, load: np.ndarray, ending: str = ""
    ) -> None:
        """Add what an action came to, and show it in mode ``human``.

        Args:
            q: true positions [rad], shape (n,).
            error: reference minus encoders [rad], shape (n,).
            load: commanded over rated torque [1], shape (n,).
            ending: why the episode ends early, or nothing.
        """
        scene = self._scene
        if scene is None:
            return
        scene.q.append(np.array(q))
        scene.error.append(np.array(error))
        scene.load, scene.ending = np.array(load), ending
        if self._mode == "human":
            if self._viewer is None:
                self._viewer = open_viewer("Gapscope", self._period)
            rms = 1e3 * float(np.sqrt(np.mean(np.square(error))))
            caption = f"{scene.title}: t = {scene.period * scene.now:.2f} s, error {rms:.2f} mrad RMS. {ending}"
            self._viewer.show(self._picture.draw(scene), caption)

    def picture(self) -> np.ndarray | None:
        """The picture now, uint8, shape (height, width, 3), in mode ``rgb_array``; nothing before the first episode."""
        if self._mode != "rgb_array" or self._scene is None:
            return None
        return self._picture.draw(self._scene)

    def close(self) -> None:
        """Close the window, if there is one; a second call does nothing."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
