"""Signature of every effect of the catalogue, drawn with the catalogue's own laws: one picture for each family.

    .venv/bin/python experiments/42_signature_pictures.py [--out docs/pictures/signatures]

A KUKA iiwa (the arm of ``gapscope demo``) moves slowly and quickly, or in a sweep from 0.5 to 8 Hz. Each panel shows
the torque gap that one effect leaves on a joint: the torque that the arm with the effect predicts, less that of the
nominal arm. Saturation shows the torque lost, rounding of the encoder the error of the position. Prints the files.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import POSTURE, iiwa

INK, SOFT, FORWARD, BACKWARD = "#1f2328", "#d0d7de", "#0072b2", "#d95f02"
"""Colours that stay apart for colour-blind readers; samples are coloured by the direction of the joint."""
RATE = 250.0
"""Samples of a motion [Hz]."""
DURATION = 12.0
"""Length of a motion [s]."""
COLUMNS = 3
"""Panels in a row."""


@dataclass(frozen=True)
class Panel:
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


def main() -> None:
    """Draw one picture for each family."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, default=Path("docs/pictures/signatures"))
    out = options.parse_args().out
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
    place.axhline(0.0, color=SOFT, linewidth=0.8)
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
        return corrected.delivered(nominal) - nominal, "torque lost [N m]"
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


MOTIONS: dict[str, Callable[[int], Motion]] = {
    "slow and fast": slow_and_fast,
    "sweep": sweep,
}
"""Motions by name."""


if __name__ == "__main__":
    main()
