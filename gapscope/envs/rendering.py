"""Pictures of a tracked arm, drawn from its kinematics: alike on every engine, with and without a display."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image
from rich.console import Console
from rich.control import Control
from rich.style import Style
from rich.text import Text as Characters

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.arm.nearest_name import check_known
from gapscope.arm.root_mean_square import rms

WIDTH, HEIGHT = 960, 560
"""Size of the picture [pixels]."""
DPI = 100
PAPER, INK, GREY, FAINT = "#fafaf7", "#262a30", "#787d82", "#d6d8d8"
ARM, GHOST, WAY, ERROR = "#f09238", "#aac6e0", "#4682c8", "#c81e2d"
"""Colours of the arm itself, of the reference, of its way, and of the tool's error."""
JOINT_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),
    *("#785ef0", "#968200", "#56b4e9", "#5a5a5a"),
)
"""Colours of joints 1, 2, ..., distinguished by colour-blind eyes too; the ninth is the first again."""
AZIMUTH, ELEVATION = np.deg2rad(-55.0), np.deg2rad(20.0)
"""Direction that the camera looks from: about z from x on, and above the ground [rad]."""
PATH_POINTS = 120
"""Points of the tool's way that are drawn."""
TRAIL = 60
"""Actions for which the error of the tool is shown."""


MODES = ("human", "rgb_array")


class Screen:
    """Pictures of one environment's episodes, n joints; one grows with every action, seen from a fixed direction.

    Args:
        kinematics: of the arm.
        mode: one of ``MODES``.
        period: time between actions [s].

    Raises:
        InputError: unknown mode.
    """

    def __init__(self, kinematics: Kinematics, mode: str, period: float) -> None:
        self._mode = check_known("render mode", mode, MODES, where="render_mode")
        self._kinematics, self._period = kinematics, period
        self._q: list[np.ndarray] = []
        self._viewer: WindowViewer | TerminalViewer | None = None

    def begin(self, title: str, q_ref: np.ndarray) -> None:
        """Begin an episode with its reference at every action [rad], shape (K + 1, n)."""
        self.title, self._q_ref = title, q_ref
        self._colours = np.resize(JOINT_COLOURS, q_ref.shape[1]).tolist()
        self._q = []
        self._error: list[np.ndarray] = []
        ca, sa = np.cos(AZIMUTH), np.sin(AZIMUTH)
        ce, se = np.cos(ELEVATION), np.sin(ELEVATION)
        # right and up in the base frame
        self._view = np.array([[-sa, ca, 0.0], [-ca * se, -sa * se, ce]])
        self._figure = Figure((WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor=PAPER)
        self._canvas = FigureCanvasAgg(self._figure)
        self._moving: list[Artist] = []
        self._figure.text(0.016, 0.95, title, color=INK, size=12)
        self._facts = self._text(0.016, 0.905, INK)
        self._ending = self._text(0.62, 0.03, ERROR)
        self._draw_arm(self._panel(0.02, 0.06, 0.56, 0.83))
        self._draw_errors()
        self._draw_loads(self._panel(0.77, 0.1, 0.21, 0.32))
        self._draw_tool()
        # scales start small and double: fitted to each picture they would jump
        self._spans, self._shown = [0.1, 0.1], [0.0, 0.0]

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
        self._q.append(np.array(q))
        self._error.append(np.array(error))
        self._load = np.array(load)
        self._ending.set_text(ending)
        if self._mode == "human":
            # opened at the first picture: whoever asks for none needs no display
            if self._viewer is None:
                self._viewer = open_viewer("Gapscope", self._period)
            self._viewer.show(self.pixels(), self.caption())

    def picture(self) -> np.ndarray | None:
        """The picture now, in mode ``rgb_array``; nothing before the first episode."""
        return self.pixels() if self._mode == "rgb_array" and self._q else None

    def close(self) -> None:
        """Close the window, if there is one; a second call does nothing."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def caption(self) -> str:
        """One line: what is seen, time and error."""
        error = f"error {1e3 * rms(self._error[-1]):.2f} mrad RMS"
        at = f"t = {self._period * (len(self._q) - 1):.2f} s"
        return f"{self.title}: {at}, {error}. {self._ending.get_text()}"

    def pixels(self) -> np.ndarray:
        """The picture as it is now, uint8, shape (``HEIGHT``, ``WIDTH``, 3)."""
        now, errors = len(self._q) - 1, 1e3 * np.array(self._error)
        for line, column in zip(self._errors, errors.T, strict=True):
            line.set_data(self._period * np.arange(now + 1), column)
        rows = zip(errors[-1].tolist(), self._load.tolist(), strict=True)
        for joint, (error, load) in enumerate(rows):
            # a torque beyond the rated one fills the bar and stays a number beside it
            tip = min(max(load, -1.0), 1.0)
            self._bars[joint].set_data([0.0, tip], [joint, joint])
            self._rows[joint].set_text(f"{joint + 1}   {error:+.2f} mrad   {load:+.2f}")
        skeleton = self._kinematics.skeleton
        actual, wanted = skeleton(self._q[-1]), skeleton(self._q_ref[now])
        self._ghost.set_data(*self._flat(wanted).T)
        for line in (self._edge, self._arm):
            line.set_data(*self._flat(actual).T)
        self._tools.set_data(*self._flat(np.array([actual[-1], wanted[-1]])).T)
        # the way of the tool up to where the reference is
        self._done.set_data(*self._flat(self._path[self._times <= now]).T)
        trail = range(max(0, now - TRAIL), now + 1)
        # its offset from where it should have been at that time, not along the way
        offset = np.array(
            [skeleton(self._q[k])[-1] - skeleton(self._q_ref[k])[-1] for k in trail]
        )
        seen = 1e3 * self._flat(offset)
        self._trail.set_data(*seen.T)
        self._tip.set_data(*seen[-1:].T)
        distance = 1e3 * float(np.linalg.norm(offset[-1]))
        self._facts.set_text(
            f"t = {self._period * now:.2f} s     error so far {rms(errors, None):.2f} mrad RMS"
            f"     tool off by {distance:.2f} mm"
        )
        self._widen(float(np.abs(errors).max()), float(np.abs(seen).max()))
        # what stays is drawn once: that takes ten times as long as what moves
        self._canvas.restore_region(self._still)
        for artist in self._moving:
            artist.draw(self._canvas.get_renderer())
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _widen(self, error: float, offset: float) -> None:
        """Double the scales of errors [mrad] and of the tool's offset [mm] until they hold these."""
        spans = self._spans
        for place, value in enumerate((error, offset)):
            while spans[place] < value:
                spans[place] *= 2.0
        if self._shown == spans:
            return
        # rare, as scales double: everything that stays is drawn again
        self._shown = spans.copy()
        self._error_panel.set_ylim(-spans[0], spans[0])
        self._tool_panel.set(xlim=(-spans[1], spans[1]), ylim=(-spans[1], spans[1]))
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)

    def _flat(self, points: np.ndarray) -> np.ndarray:
        """Right and up of points in the base frame [m], shape (N, 2)."""
        return points @ self._view.T

    def _panel(self, left: float, bottom: float, width: float, height: float) -> Axes:
        """A part of the picture, in shares of it."""
        axes = self._figure.add_axes((left, bottom, width, height), facecolor="none")
        axes.tick_params(colors=GREY, labelsize=8, length=0)
        for spine in axes.spines.values():
            spine.set_color(FAINT)
        return axes

    def _text(self, x: float, y: float, colour: str) -> Text:
        """Text that changes, at shares of the picture."""
        text = self._figure.text(x, y, "", color=colour, size=9, animated=True)
        self._moving.append(text)
        return text

    def _line(self, axes: Axes, colour: str, width: float, **look: Any) -> Line2D:
        """A line that moves."""
        (line,) = axes.plot(
            *([], []),
            color=colour,
            linewidth=width,
            solid_capstyle="round",
            solid_joinstyle="round",
            animated=True,
            **look,
        )
        self._moving.append(line)
        return line

    def _draw_arm(self, axes: Axes) -> None:
        """Ground, way of the tool, ghost and arm, at a scale at which the whole motion fits."""
        # fewer than actions of a long episode: a motion is drawn by so many points
        times = np.linspace(0, len(self._q_ref) - 1, PATH_POINTS).round().astype(int)
        self._times = np.unique(times)
        bones = np.array(
            [self._kinematics.skeleton(q) for q in self._q_ref[self._times]]
        )
        self._path = bones[:, -1]
        # squares of the ground, which reaches about as far as the arm
        side = 0.7 * max(float(np.abs(bones).max()), 1e-3)
        for place in np.linspace(-side, side, 8):
            line = np.array([[place, -side, 0.0], [place, side, 0.0]])
            for way in (line, line[:, [1, 0, 2]]):
                axes.plot(*self._flat(way).T, color=FAINT, linewidth=1.0)
        axes.update_datalim(self._flat(bones.reshape(-1, 3)))
        axes.margins(0.06)
        axes.autoscale_view()
        axes.set_aspect("equal")
        axes.axis("off")
        axes.plot(*self._flat(self._path).T, color=GHOST, linewidth=1.0)
        self._done = self._line(axes, WAY, 1.6)
        self._ghost = self._line(axes, GHOST, 24)
        # drawn wider below: the edge of the arm
        self._edge = self._line(axes, INK, 17)
        self._arm = self._line(axes, ARM, 15, marker="o", markersize=6, mfc=INK, mew=0)
        self._tools = self._line(axes, ERROR, 2, marker=".")
        named = {"arm": ARM, "reference": GHOST, "error of the tool": ERROR}
        axes.legend(
            [Line2D([], [], color=colour, linewidth=6) for colour in named.values()],
            list(named),
            loc="lower right",
            ncols=3,
            frameon=False,
            fontsize=8,
            labelcolor=GREY,
        )

    def _draw_errors(self) -> None:
        """Tracking error of each joint over the whole episode [mrad]."""
        self._error_panel = axes = self._panel(0.66, 0.52, 0.32, 0.36)
        axes.set_title("tracking error, mrad", size=9, color=INK, loc="left")
        axes.set_xlim(0.0, self._period * (len(self._q_ref) - 1))
        axes.set_xlabel("t, s", size=8, color=GREY)
        axes.grid(color=FAINT)
        self._errors = [self._line(axes, colour, 1.6) for colour in self._colours]

    def _draw_loads(self, axes: Axes) -> None:
        """Per joint its number, its present error [mrad], and its commanded over the rated torque as a bar."""
        axes.set_title("torque / rated", size=9, color=INK)
        self._bars, self._rows = [], []
        for joint, colour in enumerate(self._colours):
            self._bars.append(self._line(axes, colour, 8))
            self._bars[-1].set_solid_capstyle("butt")
            place = 0.1 + 0.32 * (1 - (joint + 0.5) / len(self._colours))
            self._rows.append(self._text(0.6, place - 0.01, INK))
        axes.set(xlim=(-1.0, 1.0), ylim=(len(self._colours) - 0.5, -0.5), yticks=[])
        axes.axvline(0.0, color=GREY, linewidth=0.8)

    def _draw_tool(self) -> None:
        """Where the tool is beside where it should be, across the line of sight [mm]."""
        self._tool_panel = axes = self._panel(0.04, 0.1, 0.13, 0.2)
        axes.set_title("tool as seen, mm", size=8, color=GREY)
        axes.set_aspect("equal")
        axes.locator_params(nbins=3)
        axes.plot(0.0, 0.0, "o", color=WAY, markersize=5)
        self._trail = self._line(axes, ERROR, 1, alpha=0.4)
        self._tip = self._line(axes, ERROR, 1, marker="o", markersize=5)


TERMINAL_PERIOD = 0.5
"""Pictures in the terminal are at least this far apart [s]."""
TERMINAL_COLUMNS, TERMINAL_ROWS = 80, 24
"""Size of a picture in the terminal [characters]; each character shows two pixels, one above the other."""


class TerminalViewer:
    """Coloured half blocks in a terminal, and the caption alone if the output is no terminal."""

    def __init__(self, console: Console | None = None) -> None:
        self._console, self._due = console or Console(), 0.0

    def show(self, picture: np.ndarray, caption: str) -> None:
        """Show a picture over the one before, if that is ``TERMINAL_PERIOD`` old."""
        if time.monotonic() < self._due:
            return
        if self._console.is_terminal:
            # the picture before is overwritten: back by its rows and the caption
            if self._due:
                self._console.control(Control.move(0, -(TERMINAL_ROWS + 1)))
            self._console.print(_half_blocks(picture), end="")
        self._console.print(caption, highlight=False, overflow="crop", no_wrap=True)
        self._due = time.monotonic() + TERMINAL_PERIOD

    def close(self) -> None:
        """Nothing stays open."""


def _half_blocks(picture: np.ndarray) -> Characters:
    """A picture as characters whose upper and lower half have the colour of a pixel each."""
    size = TERMINAL_COLUMNS, 2 * TERMINAL_ROWS
    coarse = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
    text = Characters()
    for upper, lower in zip(coarse[::2], coarse[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            style = " on ".join(
                f"rgb({red},{green},{blue})" for red, green, blue in (above, below)
            )
            text.append("▀", Style.parse(style))
        text.append("\n")
    return text


class WindowViewer:
    """A window of matplotlib; waits so that pictures follow each other in real time.

    Raises:
        ImportError: there is no display, or nothing that opens a window.
    """

    def __init__(self, title: str, period: float) -> None:
        import matplotlib
        from matplotlib import pyplot
        from matplotlib.backends import BackendFilter, backend_registry

        self._pyplot, self._period, self._due = pyplot, period, 0.0
        self._figure = pyplot.figure(title, (WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
        windows = backend_registry.list_builtin(BackendFilter.INTERACTIVE)
        # without a display pyplot falls back to one that opens none
        if matplotlib.get_backend().lower() not in (x.lower() for x in windows):
            self.close()
            raise ImportError("no window can be opened")
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.axis("off")
        self._image = axes.imshow(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        pyplot.show(block=False)

    def show(self, picture: np.ndarray, caption: str) -> None:
        """Show a picture; does nothing once the window was closed."""
        if not self._pyplot.fignum_exists(self._figure.number):
            return
        self._image.set_data(picture)
        canvas = self._figure.canvas
        canvas.draw_idle()
        # waits for what is left of the period, and lets the window live meanwhile
        canvas.start_event_loop(max(1e-3, self._due - time.monotonic()))
        self._due = time.monotonic() + self._period

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        self._pyplot.close(self._figure)


def open_viewer(title: str, period: float) -> WindowViewer | TerminalViewer:
    """A window if there is a display, else the terminal; a picture every ``period`` seconds at most."""
    try:
        return WindowViewer(title, period)
    except ImportError:
        return TerminalViewer()
