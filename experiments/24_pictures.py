"""The pictures of the documentation that show data: of README and front page, and signatures of the effects.

    GAPSCOPE_DATA=... .venv/bin/python experiments/24_pictures.py readme [--out docs/pictures] [--work out/pictures]

The overview shows the public UR10 recording (unisa-acg/inverse-dynamics-solver, BSD-3-Clause), drawn from its
diagnosis: torque of the joint whose gap closes most, and the gap of all joints. The report is that of ``gapscope
demo``, photographed by Chromium; without one the overview alone is drawn.

    .venv/bin/python experiments/24_pictures.py signatures [--out docs/pictures/signatures]

draws the signature of every effect of the catalogue with the catalogue's own laws, one picture for each family. A KUKA
iiwa (the arm of ``gapscope demo``) moves slowly and quickly, or in a sweep from 0.5 to 8 Hz. Each panel shows the
torque gap that one effect leaves on a joint: the torque that the arm with the effect predicts, less that of the nominal
arm. Saturation shows the torque lost, rounding of the encoder the error of the position.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from common import CASES, DATA, command_line, run_part
from PIL import Image

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import POSTURE, iiwa

# README and front page

CASE = CASES / "ur10.yaml"
RECORDING = "ur10/ur10_exciting.db3"
DEMO_SEED = 3
"""The mystery arm of the front page."""
SCREEN = (1200, 1600)
"""Window of the browser [pixels]."""
INK, LINE = "#1f2328", "#d0d7de"
BEFORE, AFTER = "#d95f02", "#0072b2"
"""Colours of the report: gap before and after."""
CORRECTED = {"recorded": INK, "corrected arm (fitted)": AFTER}
"""What the last panel shows."""
STRETCH = (2.0, 14.0)
"""Part of the recording that is drawn [s]."""
POINTS = 240
"""Samples of a drawn curve."""


def readme() -> None:
    """Diagnose the recording unless that is done, draw the pictures."""
    chosen = command_line(
        readme.__doc__, out=Path("docs/pictures"), work=Path("out/pictures")
    ).parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    chosen.work.mkdir(parents=True, exist_ok=True)
    if not (chosen.work / "diagnosis.json").is_file():
        gapscope("diagnose", CASE, "--out", chosen.work)

    overview = chosen.out / "overview.svg"
    draw_overview(chosen.work, overview)
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


def draw_overview(work: Path, file: Path) -> None:
    """SVG: recordings and nominal arm, the three answers, and the corrected arm."""
    diagnosis = json.loads((work / "diagnosis.json").read_text(encoding="utf-8"))
    before, after = (
        np.array(diagnosis["gap"][when]["torque_nrmse"]) for when in ("before", "after")
    )
    joint = int(np.argmax(before - after))
    curves = torque_curves(work, joint)
    figure = plt.figure(figsize=(10.8, 3.3), layout="constrained")
    left, where, which, right = figure.subplots(1, 4, width_ratios=(5, 3, 4, 5))
    drawn = {"recorded": INK, "nominal arm predicts": BEFORE}
    for place, title, colours in (
        (left, f"Recordings and nominal arm\nUR10, torque of joint {joint + 1}", drawn),
        (right, "Corrected arm\npredicts, simulates, can be exported", CORRECTED),
    ):
        for name, colour in colours.items():
            place.plot(curves[name.split()[0]], color=colour, lw=1.2, label=name)
        place.set_title(title, fontsize=10, color=INK)
        place.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, fontsize=8)
        place.set_axis_off()
    rows = np.arange(len(before))
    where.set_title("Where", fontsize=10, color=INK)
    where.barh(rows - 0.2, before, 0.3, color=BEFORE)
    where.barh(rows + 0.2, after, 0.3, color=AFTER)
    where.set_yticks(rows, [f"J{k + 1}" for k in rows])
    where.set_xticks([])
    where.invert_yaxis()
    where.spines[:].set_visible(False)
    which.set_title("Which, how far", fontsize=10, color=INK)
    which.set_axis_off()
    lines = []
    for effect in diagnosis["effects"][:6]:
        words = effect["effect"].replace("_", " ").capitalize()
        share = 100 * effect["share"]
        lines.append(f"{words}  {f'{share:.0f} %' if share >= 1 else 'below 1 %'}")
    closed = 100 * diagnosis["closed"]
    lines += ["", f"{closed:.0f} % of the gap above", "the noise floor is closed"]
    which.text(0, 1, "\n".join(lines), va="top", fontsize=9, linespacing=1.6)
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def torque_curves(work: Path, joint: int) -> dict[str, np.ndarray]:
    """Torque of one joint [N m] over the stretch: recorded, nominal and corrected arm, each of shape (POINTS,)."""
    recording = load_case(CASE).recordings[0]
    time = recording.t - recording.t[0]
    drawn = np.linspace(*STRETCH, POINTS)
    curves = {"recorded": np.interp(drawn, time, recording.tau[:, joint])}
    file = DATA / RECORDING
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


matplotlib.use("Agg")


# Signatures of the effects

FORWARD, BACKWARD = "#0072b2", "#d95f02"
"""Colours that stay apart for colour-blind readers; samples are coloured by the direction of the joint."""
RATE = 250.0
"""Samples of a motion [Hz]."""
DURATION = 12.0
"""Length of a motion [s]."""
COLUMNS = 3
"""Panels in a row."""


class Panel(NamedTuple):
    """One drawn effect: where it acts, with which values, seen on which joint over which quantity.

    ``dry`` is False if the steps of the nominal dry friction at each reversal would hide the rest.
    """

    effect: str
    joint: int
    over: str
    motion: str = "slow and fast"
    on_arm: bool = False
    dry: bool = True
    values: dict[str, Any] | None = None


PANELS = (
    Panel("coulomb_friction", 4, "velocity", values={"torque": [4.0]}),
    Panel("viscous_friction", 4, "velocity", values={"coefficient": [6.0]}),
    Panel(
        "stribeck_friction",
        4,
        "velocity",
        values={"torque": [4.0], "velocity": [0.15]},
    ),
    Panel(
        "saturating_friction",
        4,
        "velocity",
        values={"torque": [4.0], "velocity": [0.25]},
    ),
    Panel("load_friction", 4, "load", values={"coefficient": [0.1]}),
    Panel(
        "friction_drift",
        4,
        "time",
        values={"amplitude": [0.8], "time_constant": [4.0]},
    ),
    Panel(
        "payload",
        4,
        "load",
        on_arm=True,
        values={"mass": 2.0, "com": [0.0, 0.0, 0.05]},
    ),
    Panel(
        "link_inertia",
        4,
        "load",
        on_arm=True,
        values={"link": 5, "mass": 1.0, "com": [0.0, 0.02, 0.0]},
    ),
    Panel("armature", 4, "acceleration", values={"inertia": [0.4]}),
    Panel(
        "joint_elasticity",
        4,
        "time",
        "sweep",
        dry=False,
        values={"stiffness": [3000.0], "damping": [5.0]},
    ),
    Panel("backlash", 1, "time", dry=False, values={"width": [0.01]}),
    Panel(
        "parallel_spring",
        4,
        "position",
        values={"stiffness": [10.0], "rest": [-1.2]},
    ),
    Panel(
        "torque_ripple",
        4,
        "position",
        values={"amplitude": [1.0], "cycles": [30.0], "phase": [0.0]},
    ),
    Panel("torque_scale", 4, "load", values={"scale": [0.15]}),
    Panel("torque_offset", 4, "time", values={"torque": [1.5]}),
    Panel("torque_saturation", 4, "load", values={"limit": [15.0]}),
    Panel(
        "actuator_lag", 4, "time", "sweep", dry=False, values={"time_constant": [0.015]}
    ),
    Panel("actuator_delay", 4, "time", "sweep", dry=False, values={"delay": [0.015]}),
    Panel("encoder_offset", 4, "position", values={"offset": [0.03]}),
    Panel("encoder_quantization", 4, "position", values={"step": [0.1]}),
    Panel("base_tilt", 1, "position", on_arm=True, values={"roll": 0.05, "pitch": 0.0}),
    Panel(
        "external_force",
        4,
        "time",
        on_arm=True,
        values={"force": [0.0, 0.0, -20.0], "start": 4.0, "end": 7.0},
    ),
)
"""Values are large ones of those met on real arms, or larger if the signature would not be seen."""
AXES = {
    "position": "position [rad]",
    "velocity": "velocity [rad/s]",
    "acceleration": "acceleration [rad/s²]",
    "load": "nominal torque [N m]",
    "time": "time [s]",
}
"""Quantities of the horizontal axis with their units."""


def signatures() -> None:
    """Draw one picture for each family."""
    out = (
        command_line(signatures.__doc__, out=Path("docs/pictures/signatures"))
        .parse_args()
        .out
    )
    out.mkdir(parents=True, exist_ok=True)
    arm = iiwa()
    families = dict.fromkeys(CATALOGUE[panel.effect].family for panel in PANELS)
    for family in families:
        panels = [p for p in PANELS if CATALOGUE[p.effect].family == family]
        file = out / f"{family}.png"
        draw(panels, arm, file)
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


def draw(panels: list[Panel], arm: NominalArm, file: Path) -> None:
    """One picture of several panels, reduced to the few colours that it has."""
    rows = -(-len(panels) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(9.6, 2.7 * rows), squeeze=False, layout="constrained"
    )
    for panel, place in zip(panels, axes.flat, strict=False):
        draw_panel(panel, arm, place)
    for place in axes.flat[len(panels) :]:
        place.axis("off")
    figure.savefig(file, dpi=100)
    plt.close(figure)
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(32).save(file, optimize=True)


def draw_panel(panel: Panel, arm: NominalArm, place: plt.Axes) -> None:
    """Signature of one effect over its quantity, in the colours of the joint's direction."""
    motion = MOTIONS[panel.motion](arm.n_joints)
    column = panel.joint - 1
    if not panel.dry:
        arm = replace(arm, coulomb=np.zeros(arm.n_joints))
    nominal = CorrectedArm(arm).predict(RigidBody(arm), motion)
    shown, unit = signature(panel, arm, motion, nominal)
    across = {
        "position": motion.q,
        "velocity": motion.dq,
        "acceleration": motion.ddq,
        "load": nominal,
    }
    x = motion.t if panel.over == "time" else across[panel.over][:, column]
    forward = motion.dq[:, column] > 0
    place.axhline(0.0, color=LINE, linewidth=0.8)
    for direction, colour in ((forward, FORWARD), (~forward, BACKWARD)):
        place.plot(x[direction], shown[direction, column], ".", color=colour, ms=2)
    place.set_title(f"{panel.effect}, joint {panel.joint}", fontsize=9, color=INK)
    place.set_xlabel(AXES[panel.over], fontsize=8)
    place.set_ylabel(unit, fontsize=8)
    place.tick_params(labelsize=7)


def signature(
    panel: Panel, arm: NominalArm, motion: Motion, nominal: np.ndarray
) -> tuple[np.ndarray, str]:
    """What an effect leaves, shape (N, n), and the name of that quantity with its unit."""
    joints = () if panel.on_arm else (panel.joint,)
    effect = CATALOGUE[panel.effect]
    applied = AppliedEffect(panel.effect, joints, panel.values or {})
    corrected = CorrectedArm(arm, (applied,))
    if panel.effect == "encoder_quantization":
        step = applied.per_joint("step", arm.n_joints)
        return effect.recorded(motion.q, step) - motion.q, "position error [rad]"
    if panel.effect == "torque_saturation":
        return corrected.delivered(nominal, motion) - nominal, "torque lost [N m]"
    return corrected.predict(RigidBody(arm), motion) - nominal, "torque gap [N m]"


def slow_and_fast(n_joints: int) -> Motion:
    """Two sines per joint about the posture of the demo, with their exact derivatives."""
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    phase = np.arange(n_joints)
    motion = np.zeros((3, len(t), n_joints))
    motion[0] = POSTURE
    for amplitude, frequency in ((0.35, 0.25), (0.12, 0.9)):
        w = 2 * np.pi * frequency
        angle = w * t[:, None] + phase
        motion[0] += amplitude * np.sin(angle)
        motion[1] += amplitude * w * np.cos(angle)
        motion[2] -= amplitude * w**2 * np.sin(angle)
    return Motion(t, *motion)


def sweep(n_joints: int) -> Motion:
    """A sine on all joints whose frequency rises from 0.5 to 8 Hz at a constant speed of 0.3 rad/s."""
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    frequency = 0.5 * 16.0 ** (t / DURATION)
    w = 2 * np.pi * frequency
    angle = np.cumsum(w) / RATE
    speed = 0.3 * np.cos(angle)
    position = np.cumsum(speed) / RATE
    state = position, speed, -0.3 * w * np.sin(angle)
    columns = [np.tile(x[:, None], n_joints) for x in state]
    return Motion(t, POSTURE + columns[0], columns[1], columns[2])


MOTIONS = {
    "slow and fast": slow_and_fast,
    "sweep": sweep,
}
"""Motions by name."""


if __name__ == "__main__":
    run_part(__doc__, readme, signatures)
