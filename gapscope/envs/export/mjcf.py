"""A corrected arm as MJCF: what ``templates/mjcf.xml.j2`` is filled with.

Dry friction that Coulomb's law does not say is written as bristles of the LuGre model, which MuJoCo's ``dcmotor`` has.
A bristle bends by z and slips at g(v),

    dz/dt = v - sigma0 |v| z / g(v),   friction = sigma0 z + sigma1 dz/dt,   g(v) = Fc + (Fs - Fc) exp(-(v / vs)^2),

so that at a constant speed the friction is g(v) sgn v (canudas1995). With Fs = Fc and sigma1 = 0 it is Dahl's model of
``gapscope.effects.friction``, whose distance is Fc / sigma0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gapscope.arm.dynamics.link_shapes import PlacedShape
from gapscope.arm.dynamics.plain_urdf import numbers, rotation
from gapscope.envs.drive.arm_drive import (
    TOOTH_DAMPING,
    TOOTH_FREQUENCY,
    mass_matrices,
    substeps,
)
from gapscope.envs.export.plain_arm import PASSIVE, PlainArm, mesh_path
from gapscope.envs.export.texts import rendered

MESHES = (".stl", ".obj", ".msh")
"""Endings of the meshes that MuJoCo reads."""
MAX_FACES = 200_000
"""MuJoCo reads no STL file with more."""
ROUNDING = 1e-9
"""Share by which a moment of inertia may exceed the sum of the others before it counts as odd."""
LEAST = 1e-12
"""Mass [kg] and moments of inertia [kg m^2] that MuJoCo gives a moving body that has none."""
LONGEST_STEP = 1e-3
"""Time step of a file without springs [s]."""
STIFFEST = 1.0
"""Phase that a bristle's resonance may cover in a step, w dt [rad]: MuJoCo's step of the bristle is explicit."""
MIN_SHARE = 0.01
"""Share of the Stribeck peak that its bristle keeps in fast motion [1], since MuJoCo divides by g(v)."""
TANH_SHARES = (0.3683, 0.1010, 0.5307)
"""Shares w_i of the bristles that together are tanh(x), sum_i w_i (1 - exp(-(x / s_i)^2)); see ``TANH_SPEEDS``."""
TANH_SPEEDS = (0.4220, 0.0713, 1.1432)
"""Their s_i [1]: the minimax fit for all x, wrong by at most ``TANH_ERROR``."""
TANH_ERROR = 0.012
"""Largest error of the three bristles for tanh(x) [1]."""


def as_mjcf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as MJCF, and what else is left out.

    Collision shapes are in group 3, visual ones in group 2; links that are fixed to a body are sites. What an actuator
    is commanded is the recorded torque: clipped, delayed, lagged, scaled and offset as the drive does it. A joint with
    elasticity or free play has a second joint beside it, that of its motor. Sensors hold what the encoders read.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.

    Raises:
        InputError: friction or rotor inertia of a coupled motor is negative, or a stiffness needs a step that is too
            short to be simulated.
    """
    bounds, notes = _bounds(arm)
    step = time_step(arm)
    meshes: dict[tuple[str, str], str] = {}
    shapes = []
    for number, shape in enumerate(arm.shapes):
        name = ""
        if problem := _unreadable(shape):
            notes.append(f"a {shape.use} shape of link {shape.frame.name}: {problem}")
            continue
        if shape.mesh is not None:
            file = mesh_path(shape.mesh, out, relative)
            own = f"{Path(file).stem}_{number}"
            name = meshes.setdefault((file, numbers(np.array(shape.size))), own)
        shapes.append((shape, name))
    for joint, drive in arm.drives.iterrows():
        bristle = dry_bristle(drive, step)
        if bristle is not None and builds_up(drive):
            distance = bristle.coulomb / bristle.stiffness
            if distance > 1.01 * drive.presliding:
                notes.append(
                    f"presliding of {joint}: friction builds up over {distance:.3g} rad in place of "
                    f"{drive.presliding:.3g}, which steps of {step:.3g} s cannot hold"
                )
    text = rendered(
        "mjcf.xml.j2",
        arm=arm,
        step=step,
        bounds=bounds,
        shapes=shapes,
        meshes=meshes,
        coupled=_coupled_motors(arm),
        motor_name=lambda joint: joint + "_motor" * bool(arm.drives.at[joint, "gear"]),
        builds_up=builds_up,
        dry_bristle=dry_bristle,
        saturating_bristles=saturating_bristles,
        # MuJoCo applies a step's last torque throughout, which is early by half a step. The delay of its filter is
        # e / (1 - e) steps, with e = exp(-step / T'), at low frequency; it is T for T' = step / ln(1 + step / T)
        filter_time=lambda lag: step / np.log1p(step / lag),
        rotation=rotation,
        within=_within,
        teeth=(1 / (2 * np.pi * TOOTH_FREQUENCY * TOOTH_DAMPING), TOOTH_DAMPING),
    )
    return text, tuple(dict.fromkeys(notes))


def time_step(arm: PlainArm) -> float:
    """Time step that follows the gears and springs [s].

    Raises:
        InputError: a stiffness needs a step that is too short to be simulated.
    """
    drives = arm.drives.iloc[arm.body.order]
    gear = drives["gear"].to_numpy()
    rotors, stiffness, damping, spring = (
        drives[name].to_numpy()
        for name in ("rotor", "gear_stiffness", "gear_damping", "stiffness")
    )
    masses = mass_matrices(arm.body)
    parts = substeps(masses, rotors, gear, stiffness, damping, spring, LONGEST_STEP)
    return LONGEST_STEP / parts


class Bristle(NamedTuple):
    """sigma0 [N m/rad], sigma1 [N m s/rad], Fc and Fs [N m], vs [rad/s], in MuJoCo's order."""

    stiffness: float
    damping: float
    coulomb: float
    static: float
    velocity: float


def dry_bristle(drive: pd.Series, step: float) -> Bristle | None:
    """The bristle of dry friction; ``None`` if Coulomb friction, set-valued at rest, says it all.

    With a presliding distance it carries Coulomb and Stribeck friction, and its damper makes good the step by which
    the explicit spring is late. Otherwise it carries the Stribeck peak beside Coulomb friction, which holds the joint
    at rest: as stiff as the step allows, and without a damper, whose torque would peak where g falls.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    peak, speed = drive.breakaway, drive.breakaway_speed
    stiffest = drive.inertia * (STIFFEST / step) ** 2
    if builds_up(drive):
        stiffness = min(drive.friction / drive.presliding, stiffest)
        static = drive.friction + peak
        velocity = speed if peak else 1.0
        return Bristle(stiffness, stiffness * step, drive.friction, static, velocity)
    if peak:
        return Bristle(stiffest, 0.0, MIN_SHARE * peak, peak, speed)
    return None


def builds_up(drive: pd.Series) -> bool:
    """Whether Coulomb friction builds up over a distance."""
    return bool(drive.presliding > 0 and drive.friction > 0)


def saturating_bristles(drive: pd.Series, step: float) -> tuple[Bristle, ...]:
    """Saturating friction d tanh(v / vt) as bristles that carry nothing at rest, to ``TANH_ERROR`` of d.

    They need no damping, as they do not stick.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    if drive.saturating == 0:
        return ()
    stiffness = drive.inertia * (STIFFEST / step) ** 2
    return tuple(
        Bristle(
            stiffness,
            0.0,
            share * drive.saturating,
            0.0,
            relative * drive.saturating_speed,
        )
        for share, relative in zip(TANH_SHARES, TANH_SPEEDS, strict=True)
    )


def _coupled_motors(arm: PlainArm) -> list[dict[str, Any]]:
    """Rotor and friction of each motor that turns several joints, and its ratio by joint.

    Raises:
        InputError: friction or rotor inertia is negative.
    """
    corrected = arm.corrected
    if corrected.arm.coupling is None:
        return []
    columns = {name: corrected.passive(f"motor_{name}") for name in PASSIVE}
    return [
        {name: column[motor] for name, column in columns.items()}
        | {
            "number": motor + 1,
            "ratios": dict(zip(corrected.arm.joints, ratios, strict=True)),
        }
        for motor, ratios in enumerate(corrected.arm.coupling)
        if any(column[motor] > 0 for column in columns.values())
    ]


def _bounds(arm: PlainArm) -> tuple[dict[str, str], list[str]]:
    """Attributes that let MuJoCo correct bodies that it would refuse, with a note."""
    bounds: dict[str, str] = {}
    notes = []
    if any(link.mass < LEAST or link.moments.max() < LEAST for link in arm.links):
        bounds["boundmass"] = bounds["boundinertia"] = repr(LEAST)
    elif any(link.moments.min() < LEAST for link in arm.links):
        bounds["boundinertia"] = repr(LEAST)
    odd = [
        link.joint
        for link in arm.links
        if link.moments[2] * (1 - ROUNDING) > link.moments[0] + link.moments[1]
    ]
    if odd:
        bounds["balanceinertia"] = "true"
        notes.append(
            f"principal moments of what is moved by {', '.join(odd)}: one is above the sum of the others, and MuJoCo "
            "puts their mean in their place"
        )
    return bounds, notes


def _within(moments: np.ndarray) -> np.ndarray:
    """Ascending principal moments [kg m^2], (3,), of which rounding does not raise the last above the others' sum."""
    low, middle, high = moments.tolist()
    return np.array(
        [
            low,
            middle,
            low + middle if 0 < high - low - middle <= ROUNDING * high else high,
        ]
    )


def _unreadable(shape: PlacedShape) -> str:
    """Why MuJoCo cannot read a shape's mesh, or an empty string."""
    if shape.mesh is None:
        return ""
    if shape.mesh.suffix.lower() not in MESHES:
        return f"MuJoCo reads no {shape.mesh.suffix or 'such'} file ({shape.mesh.name})"
    if shape.mesh.suffix.lower() == ".stl":
        with shape.mesh.open("rb") as file:
            head = file.read(84)
        faces = int.from_bytes(head[80:84], "little")
        if len(head) < 84 or shape.mesh.stat().st_size != 84 + 50 * faces:
            return f"MuJoCo reads no STL file in text ({shape.mesh.name})"
        if faces > MAX_FACES:
            return f"MuJoCo reads no mesh with more than {MAX_FACES} faces ({shape.mesh.name})"
    return ""
