"""Recordings of a simulated seven-joint arm for the stories of identification: the truth is known, noise is added."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, Limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

N = 7
RATE = 250.0
NOISE = 0.01
"""Noise of the torque over its standard deviation."""
FACTORS = {3: 0.3, 7: 6.0}
"""Links whose mass and inertia are scaled: a light upper arm, whose mass an error soon makes negative, and a tool."""


@cache
def arm() -> NominalArm:
    """A Panda with a light upper arm and a heavy tool, and with rotors and friction in its data sheet."""
    plain = load_nominal_arm("franka_panda")
    text = plain.urdf.read_text(encoding="utf-8")
    for link, factor in FACTORS.items():
        start = text.index("<inertial", text.index(f'<link name="panda_link{link}"'))
        end = text.index("</inertial>", start)
        parts = re.split(r'((?:mass value|i[xyz][xyz])=")([^"]+)', text[start:end])
        parts[2::3] = [str(float(number) * factor) for number in parts[2::3]]
        text = text[:start] + "".join(parts) + text[end:]
    path = Path(mkdtemp()) / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return replace(
        plain,
        urdf=path,
        armature=np.array([0.4, 0.4, 0.25, 0.25, 0.1, 0.08, 0.05]),
        coulomb=np.array([5.0, 5.0, 4.0, 4.0, 3.0, 2.0, 1.5]),
        viscous=np.array([4.0, 4.0, 3.0, 3.0, 2.0, 1.0, 0.8]),
    )


@cache
def body() -> RigidBody:
    """Its rigid bodies."""
    return RigidBody(arm())


def motion(
    seed: int, *, size: float = 1.5, speed: float = 1.5, duration: float = 10.0
) -> Fourier:
    """A smooth motion of all joints, up to ``size`` [rad] and ``speed`` [rad/s]."""
    limits = Limits(
        np.full(N, -size), np.full(N, size), np.full(N, speed), np.full(N, 5.0 * speed)
    )
    rng = np.random.default_rng(seed)
    return Fourier.random(rng, limits, duration=duration, frequency=0.2, order=5)


def recording(
    name: str,
    seed: int,
    effects: tuple[AppliedEffect, ...] = (),
    noise: float = NOISE,
    **how: float,
) -> Recording:
    """What would be logged: encoders by the effects of sensing, torque of the arm with the others, and noise."""
    reference = motion(seed, **how)
    t = np.arange(round(reference.duration * RATE) + 1) / RATE
    corrected = CorrectedArm(arm(), effects)
    q = reference.position(t) + corrected.value("encoder_offset", "offset")
    tau = corrected.predict(
        body(), Motion(t, q, reference.velocity(t), reference.acceleration(t))
    )
    rng = np.random.default_rng(1000 + seed)
    return Recording(
        name, t, q, tau + noise * tau.std(axis=0) * rng.standard_normal(tau.shape)
    )


def case(
    effects: tuple[AppliedEffect, ...] = (), seed: int = 0, count: int = 2, **how: float
) -> Case:
    """A case of some recordings, the last of which is judged on."""
    recordings = tuple(
        recording(f"recording_{k}.csv", 10 * seed + k, effects, **how)
        for k in range(count)
    )
    return Case("panda", Path(), arm(), recordings)


def changed(original: Case, change: Callable[[Recording], Recording]) -> Case:
    """A case with every recording changed."""
    return replace(original, recordings=tuple(change(r) for r in original.recordings))
