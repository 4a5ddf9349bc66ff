"""A canvas with smooth edges: drawn at twice the size, then halved."""

from __future__ import annotations

from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

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
