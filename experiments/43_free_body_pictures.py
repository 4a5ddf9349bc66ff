"""Free-body pictures of the effects' families: what acts on which body, with the symbols of the catalogue.

    .venv/bin/python experiments/43_free_body_pictures.py [--out docs/pictures/free_bodies]

Writes one SVG for each family and prints the files. The laws are those of the tables in `docs/effects/`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, radians, sin
from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write

INK, SOFT, FORCE, LAW = "#1f2328", "#8c959f", "#0072b2", "#d55e00"
"""Bodies, help lines, torques and forces that are known, and what the effect adds."""
WIDTH, HEIGHT = 740, 230


@dataclass
class Sketch:
    """Parts of one picture, in pixels from its upper left corner."""

    parts: list[str] = field(default_factory=list)

    def line(
        self,
        x: float,
        y: float,
        to_x: float,
        to_y: float,
        colour: str = INK,
        width: float = 2,
        more: str = "",
    ) -> None:
        """A straight line."""
        self.parts.append(
            f'<line x1="{x}" y1="{y}" x2="{to_x}" y2="{to_y}" stroke="{colour}" stroke-width="{width}" {more}/>'
        )

    def arrow(
        self, x: float, y: float, to_x: float, to_y: float, colour: str = FORCE
    ) -> None:
        """A force."""
        self.line(x, y, to_x, to_y, colour, 2.5, f'marker-end="url(#{colour[1:]})"')

    def turn(
        self,
        x: float,
        y: float,
        radius: float,
        start: float,
        end: float,
        colour: str = FORCE,
    ) -> None:
        """A torque: an arc from one angle to another [degrees, counted against the clock from the right]."""
        from_x, from_y = (
            x + radius * cos(radians(start)),
            y - radius * sin(radians(start)),
        )
        to_x, to_y = x + radius * cos(radians(end)), y - radius * sin(radians(end))
        large, sweep = int(abs(end - start) > 180), int(end < start)
        self.parts.append(
            f'<path d="M {from_x:.1f} {from_y:.1f} A {radius} {radius} 0 {large} {sweep} {to_x:.1f} {to_y:.1f}" '
            f'fill="none" stroke="{colour}" stroke-width="2.5" marker-end="url(#{colour[1:]})"/>'
        )

    def link(self, x: float, y: float, to_x: float, to_y: float) -> None:
        """A link, with the joint that it turns about."""
        self.line(x, y, to_x, to_y, SOFT, 18, 'stroke-linecap="round" opacity="0.45"')
        self.parts.append(
            f'<circle cx="{x}" cy="{y}" r="7" fill="#fff" stroke="{INK}" stroke-width="2"/>'
        )

    def body(self, x: float, y: float, width: float, height: float, text: str) -> None:
        """A box with a word in it."""
        self.parts.append(
            f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="#fff" stroke="{INK}" '
            'stroke-width="2"/>'
        )
        self.text(x + width / 2, y + height / 2 + 5, text, middle=True)

    def text(
        self, x: float, y: float, words: str, colour: str = INK, *, middle: bool = False
    ) -> None:
        """Words."""
        anchor = ' text-anchor="middle"' if middle else ""
        self.parts.append(
            f'<text x="{x}" y="{y}" fill="{colour}"{anchor}>{words}</text>'
        )

    def svg(self, title: str) -> str:
        """The picture as a file."""
        heads = "".join(
            f'<marker id="{colour[1:]}" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="6" markerHeight="6" '
            f'orient="auto-start-reverse"><path d="M 0 0 L 10 5 L 0 10 z" fill="{colour}"/></marker>'
            for colour in (INK, FORCE, LAW)
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
            f'height="{HEIGHT}" font-family="sans-serif" font-size="15" role="img"><title>{title}</title>'
            f'<defs>{heads}</defs><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>'
            + "".join(self.parts)
            + "</svg>\n"
        )


def friction() -> Sketch:
    """A joint that turns, and what holds against it."""
    s = Sketch()
    s.link(150, 150, 310, 90)
    s.turn(150, 150, 52, 75, 165)
    s.text(66, 92, "τ recorded", FORCE)
    s.turn(150, 150, 78, -55, -125, LAW)
    s.text(206, 214, "friction, against v", LAW)
    s.turn(230, 120, 70, 0, 50, INK)
    s.text(306, 62, "v = dq/dt")
    s.text(350, 110, "τ recorded = τ of the bodies")
    s.text(350, 138, "+ c sgn v + b v + d exp(−(v/vs)²) sgn v", LAW)
    s.text(350, 162, "+ d tanh(|v|/vs) sgn v + μ |τ load| sgn v", LAW)
    return s


def rigid_body() -> Sketch:
    """Two links, their masses, a load and a rotor."""
    s = Sketch()
    s.link(90, 190, 210, 100)
    s.link(210, 100, 380, 80)
    for x, y, name in ((150, 145, "m₁"), (295, 90, "m₂")):
        s.arrow(x, y, x, y + 55)
        s.text(x + 8, y + 52, f"{name} g", FORCE)
    s.parts.append(f'<circle cx="400" cy="78" r="13" fill="{LAW}" opacity="0.8"/>')
    s.text(385, 52, "payload m at c", LAW)
    s.arrow(400, 92, 400, 150, LAW)
    s.turn(90, 190, 38, 20, 150, LAW)
    s.text(14, 140, "rotor: I a", LAW)
    s.arrow(295, 90, 322, 72, LAW)
    s.text(300, 30, "dm, dc of a link", LAW)
    s.text(440, 120, "τ = Y(q, dq, ddq) π")
    s.text(440, 146, "+ Y of the changed link Δπ", LAW)
    s.text(440, 172, "+ I a", LAW)
    return s


def transmission() -> Sketch:
    """A rotor, a gear with spring, damper and play, and a link."""
    s = Sketch()
    s.parts.append(
        f'<circle cx="80" cy="110" r="42" fill="#fff" stroke="{INK}" stroke-width="2"/>'
    )
    s.text(80, 115, "rotor I", middle=True)
    s.turn(80, 110, 60, 60, 150)
    s.text(24, 36, "τ motor", FORCE)
    s.text(80, 175, "θ", middle=True)
    zigzag = " ".join(
        f"{140 + 12 * k},{80 + (12 if k % 2 else -12)}" for k in range(1, 8)
    )
    s.parts.append(
        f'<polyline points="122,80 140,80 {zigzag} 236,80 260,80" fill="none" stroke="{LAW}" stroke-width="2.5"/>'
    )
    s.text(190, 58, "k", LAW, middle=True)
    s.line(122, 140, 180, 140, LAW, 2.5)
    s.line(180, 128, 180, 152, LAW, 2.5)
    s.parts.append(
        f'<path d="M 205 126 H 170 V 154 H 205" fill="none" stroke="{LAW}" stroke-width="2.5"/>'
    )
    s.line(170, 140, 166, 140, LAW, 2.5)
    s.line(205, 140, 260, 140, LAW, 2.5)
    s.text(190, 176, "d", LAW, middle=True)
    s.line(260, 80, 260, 140, LAW, 2.5)
    s.line(260, 110, 286, 110, LAW, 2.5)
    s.line(286, 96, 286, 124, LAW, 2.5)
    s.line(310, 90, 310, 130, LAW, 2.5)
    s.text(298, 152, "w", LAW, middle=True)
    s.link(330, 110, 440, 80)
    s.text(330, 150, "q", middle=True)
    s.line(400, 200, 400, 100, LAW, 2, 'stroke-dasharray="5 4"')
    s.text(408, 196, "k (q − q₀): spring beside the joint", LAW)
    s.text(460, 92, "τ = k (θ − q) + d (dθ − dq)", LAW)
    s.text(460, 118, "0 while |θ − q| &lt; w/2", LAW)
    return s


def actuation() -> Sketch:
    """From the recorded torque to the joint, in order."""
    s = Sketch()
    names = ("clip", "delay", "lag", "1 + s", "+ offset", "+ ripple")
    laws = ("limit", "u(t − T)", "1/(1 + T s)", "scale", "constant", "A sin(n q + φ)")
    s.text(6, 84, "τ recorded", FORCE)
    for k, (name, law) in enumerate(zip(names, laws, strict=True)):
        x = 104 + 88 * k
        s.arrow(x - 18 if k else 88, 100, x, 100, FORCE)
        s.body(x, 78, 70, 44, name)
        s.text(x + 35, 146 + 22 * (k % 2), law, LAW, middle=True)
    s.arrow(614, 100, 644, 100, FORCE)
    s.link(662, 100, 704, 60)
    s.text(646, 142, "τ applied", FORCE)
    s.text(100, 212, "τ applied = what the bodies and friction need")
    return s


def sensing() -> Sketch:
    """From the true position to the recorded one."""
    s = Sketch()
    s.link(80, 160, 200, 90)
    s.turn(80, 160, 70, 0, 28, INK)
    s.text(158, 148, "q true")
    s.line(80, 160, 220, 160, SOFT, 1.5, 'stroke-dasharray="5 4"')
    s.arrow(240, 110, 280, 110)
    s.body(280, 88, 90, 44, "+ delta")
    s.arrow(370, 110, 410, 110)
    s.body(410, 88, 100, 44, "round to s")
    s.arrow(510, 110, 552, 110)
    s.text(556, 115, "q recorded", FORCE)
    s.text(280, 170, "a zero off by delta turns gravity with it", LAW)
    s.text(280, 194, "steps of s become spikes in dq and ddq", LAW)
    return s


def environment() -> Sketch:
    """A base that is turned, and a force from outside."""
    s = Sketch()
    s.line(40, 200, 230, 200, SOFT, 2, 'stroke-dasharray="5 4"')
    s.line(40, 200, 226, 172, LAW, 3)
    s.turn(40, 200, 150, 0, 8, LAW)
    s.text(200, 222, "roll, pitch", LAW)
    s.link(130, 186, 160, 90)
    s.link(160, 90, 320, 66)
    s.arrow(250, 78, 250, 140)
    s.text(258, 138, "R^T g", FORCE)
    s.arrow(318, 130, 318, 80, LAW)
    s.text(328, 128, "f, from t₀ to t₁", LAW)
    s.text(490, 80, "gravity in the base: R^T g")
    s.text(490, 106, "R = Ry(pitch) Rx(roll)", LAW)
    s.text(490, 132, "τ recorded = τ − J^T f", LAW)
    return s


PICTURES: dict[str, Callable[[], Sketch]] = {
    "friction": friction,
    "rigid_body": rigid_body,
    "transmission": transmission,
    "actuation": actuation,
    "sensing": sensing,
    "environment": environment,
}
"""Pictures by the page of their family."""


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/free_bodies"))
    out = parser.parse_args().out
    for name, draw in PICTURES.items():
        path = out / f"{name}.svg"
        with atomic_write(path) as aside:
            aside.write_text(draw().svg(name.replace("_", " ")), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
