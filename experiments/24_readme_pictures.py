"""The pictures of README and front page: an overview, and the first screen of a report.

    GAPSCOPE_DATA=... .venv/bin/python experiments/24_readme_pictures.py [--out docs/pictures] [--work out/pictures]

The overview shows the public UR10 recording (unisa-acg/inverse-dynamics-solver, BSD-3-Clause) by its diagnosis: torque
of the joint whose gap closes most, and the gap of all joints. The report is that of `gapscope demo`, photographed by
Chromium; without one the overview alone is drawn. Prints the files written and their sizes.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from gapscope.arm.case import load_case

CASE = Path(__file__).parent / "cases" / "ur10.yaml"
RECORDING = "ur10/ur10_exciting.db3"
DEMO_SEED = 3
"""The mystery arm of the front page."""
SCREEN = (1200, 1600)
"""Window of the browser [pixels]."""
PAPER, INK, SOFT, LINE = "#ffffff", "#1f2328", "#57606a", "#d0d7de"
BEFORE, AFTER = "#d95f02", "#0072b2"
"""Colours of the report: gap before and after."""
STRETCH = (2.0, 14.0)
"""Part of the recording that is drawn [s]."""
POINTS = 240
"""Samples of a drawn curve."""


def main() -> None:
    """Diagnose the recording unless that is done, draw the pictures."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, default=Path("docs/pictures"))
    options.add_argument("--work", type=Path, default=Path("out/pictures"))
    chosen = options.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    chosen.work.mkdir(parents=True, exist_ok=True)
    if not (chosen.work / "diagnosis.json").is_file():
        gapscope("diagnose", CASE, "--out", chosen.work)

    overview = chosen.out / "overview.svg"
    overview.write_text(draw_overview(chosen.work), encoding="utf-8")
    print(f"{overview}: {overview.stat().st_size / 1000:.0f} kB")

    demo = chosen.work / "demo"
    if not (demo / "diagnosis").is_dir():
        gapscope("demo", "--seed", DEMO_SEED, "--out", demo)
    picture = chosen.out / "demo.png"
    if photograph(demo / "diagnosis" / "report.html", picture):
        print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")
    else:
        print("no Chromium: the report is not photographed")


def gapscope(*arguments: object) -> None:
    """Run a command of the project."""
    command = [sys.executable, "-m", "gapscope", *map(str, arguments)]
    subprocess.run(command, check=True)


def draw_overview(work: Path) -> str:
    """SVG: recordings and nominal arm, the three answers, and the corrected arm."""
    diagnosis = json.loads((work / "diagnosis.json").read_text(encoding="utf-8"))
    before = np.array(diagnosis["gap"]["before"]["torque_nrmse"])
    after = np.array(diagnosis["gap"]["after"]["torque_nrmse"])
    joint = int(np.argmax(before - after))
    curves = torque_curves(work, joint)
    low = min(curve.min() for curve in curves.values())
    high = max(curve.max() for curve in curves.values())

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1080 330" '
        f'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" fill="{INK}">',
        f'<rect width="1080" height="330" fill="{PAPER}"/>',
        *panel(
            10, 280, "Recordings and nominal arm", f"UR10, torque of joint {joint + 1}"
        ),
        polyline(curves["recorded"], (30, 110, 240, 150), (low, high), INK),
        polyline(curves["nominal"], (30, 110, 240, 150), (low, high), BEFORE),
        *legend(30, 285, [("recorded", INK), ("nominal arm predicts", BEFORE)]),
        arrow(296),
        *panel(320, 440, "Diagnosis", "where, which, how far"),
        *where(before, after, 340, 112),
        *which(diagnosis["effects"], 520, 112),
        *how_far(diagnosis["closed"], 340, 285),
        arrow(766),
        *panel(790, 280, "Corrected arm", "predicts, simulates, can be exported"),
        polyline(curves["recorded"], (810, 110, 240, 150), (low, high), INK),
        polyline(curves["corrected"], (810, 110, 240, 150), (low, high), AFTER),
        *legend(810, 285, [("recorded", INK), ("corrected arm (fitted)", AFTER)]),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def torque_curves(work: Path, joint: int) -> dict[str, np.ndarray]:
    """Torque of one joint [N m] over the stretch: recorded, nominal and corrected arm, each of shape (POINTS,)."""
    recording = load_case(CASE).recordings[0]
    time = recording.t - recording.t[0]
    drawn = np.linspace(*STRETCH, POINTS)
    curves = {"recorded": np.interp(drawn, time, recording.tau[:, joint])}
    file = Path(os.environ["GAPSCOPE_DATA"]) / RECORDING
    for name, model in {
        "nominal": (),
        "corrected": ("--model", work / "corrected.yaml"),
    }.items():
        table = work / f"{name}.csv"
        gapscope("predict", CASE, "--recording", file, *model, "--out", table)
        predicted = pd.read_csv(table)
        shifted = predicted["t"] - predicted["t"].iloc[0]
        curves[name] = np.interp(drawn, shifted, predicted[f"tau{joint + 1}"])
    return curves


def panel(x: int, width: int, title: str, below: str) -> list[str]:
    """Frame with a title and a line of text below it."""
    return [
        f'<rect x="{x}" y="10" width="{width}" height="310" rx="8" fill="none" stroke="{LINE}"/>',
        text(x + 20, 42, title, size=15, bold=True),
        text(x + 20, 66, below, size=13, colour=SOFT),
    ]


def polyline(
    curve: np.ndarray,
    box: tuple[int, int, int, int],
    span: tuple[float, float],
    colour: str,
) -> str:
    """Curve in a box (x, y, width, height), scaled to the span of values."""
    x0, y0, width, height = box
    low, high = span
    across = x0 + width * np.linspace(0, 1, len(curve))
    down = y0 + height * (high - curve) / (high - low)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.8"/>'


def legend(x: int, y: int, entries: list[tuple[str, str]]) -> list[str]:
    """Coloured dashes, each with its name."""
    parts = []
    for name, colour in entries:
        parts.append(f'<path d="M{x} {y - 4}h16" stroke="{colour}" stroke-width="3"/>')
        parts.append(text(x + 22, y, name, size=12, colour=SOFT))
        x += 40 + 7 * len(name)
    return parts


def where(before: np.ndarray, after: np.ndarray, x: int, y: int) -> list[str]:
    """Bars of the gap per joint, before and after."""
    parts = [text(x, y, "Where", size=14, bold=True)]
    scale = 110 / before.max()
    for number, (old, new) in enumerate(zip(before, after, strict=True), start=1):
        top = y + 12 + 22 * (number - 1)
        parts += [
            text(x, top + 11, f"J{number}", size=12, colour=SOFT),
            bar(x + 26, top, scale * old, BEFORE),
            bar(x + 26, top + 7, scale * new, AFTER),
        ]
    return parts


def bar(x: float, y: float, width: float, colour: str) -> str:
    """Horizontal bar."""
    return f'<rect x="{x}" y="{y}" width="{width:.1f}" height="6" fill="{colour}"/>'


def which(effects: list[dict], x: int, y: int) -> list[str]:
    """Names of the effects with their shares of the gap."""
    parts = [text(x, y, "Which", size=14, bold=True)]
    for number, effect in enumerate(effects[:6]):
        line = y + 24 + 22 * number
        share = 100 * effect["share"]
        words = effect["effect"].replace("_", " ").capitalize()
        parts.append(text(x, line, words, size=13))
        number_text = f"{share:.0f} %" if share >= 1 else "below 1 %"
        parts.append(text(x + 220, line, number_text, size=13, colour=SOFT, end=True))
    return parts


def how_far(closed: float, x: int, y: int) -> list[str]:
    """One line: the share of the gap that closes."""
    sentence = f"{100 * closed:.0f} % of the gap above the noise floor is closed"
    return [
        text(x, y, "How far", size=14, bold=True),
        text(x + 75, y, sentence, size=13),
    ]


def arrow(x: int) -> str:
    """Arrow to the right between two panels."""
    return f'<path d="M{x} 165h12m-6 -6l6 6l-6 6" fill="none" stroke="{SOFT}" stroke-width="2"/>'


def text(
    x: float,
    y: float,
    words: str,
    *,
    size: int,
    colour: str = INK,
    bold: bool = False,
    end: bool = False,
) -> str:
    """One line of text."""
    weight = ' font-weight="bold"' if bold else ""
    anchor = ' text-anchor="end"' if end else ""
    return f'<text x="{x}" y="{y}" font-size="{size}" fill="{colour}"{weight}{anchor}>{words}</text>'


def photograph(page: Path, picture: Path) -> bool:
    """Picture of the upper part of a page, or ``False`` if there is no browser."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                f"--user-data-dir={folder}/profile",
                f"--window-size={SCREEN[0]},{SCREEN[1]}",
                f"--screenshot={shot}",
                page.resolve().as_uri(),
            ],
            check=True,
            capture_output=True,
        )
        with Image.open(shot) as whole:
            upper = whole.crop((0, 0, SCREEN[0] - 25, 1110)).convert("RGB")
            upper.quantize(128).save(picture, optimize=True)
    return True


if __name__ == "__main__":
    main()
