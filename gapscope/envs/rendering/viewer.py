"""Where a person looks at pictures: a window, or the terminal if there is no display."""

from __future__ import annotations

import os
import sys
import time
from typing import Any, Protocol

import numpy as np
from rich.console import Console
from rich.control import Control
from rich.style import Style
from rich.text import Text

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
