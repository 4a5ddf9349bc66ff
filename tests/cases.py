"""The motions, recordings and cases of the tests, of the arms of ``arms.py``."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from arms import tooled_panda
from numpy.typing import ArrayLike

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import check_document
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.motions.trajectory import (
    Fourier,
    Limits,
    motion_of,
    urdf_limits,
)
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import (
    Inputs,
    Layout,
    Network,
    ResidualNetwork,
    Trust,
    draw_basis,
    part_of_each,
)
from gapscope.envs.mystery_arm import POSTURE, iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record

Effects = tuple[AppliedEffect, ...]


def limits(n: int, position: float, speed: float, acceleration: float) -> Limits:
    """The same limits of n joints, to both sides [rad, rad/s, rad/s^2]."""
    values = (-position, position, speed, acceleration)
    return Limits(*(np.full(n, value) for value in values))


def to_and_fro(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two joints to and fro: position [rad] and velocity [rad/s], each (N, 2)."""
    q = np.column_stack([np.sin(3 * t), 0.5 * np.cos(4 * t)])
    return q, np.column_stack([3 * np.cos(3 * t), -2 * np.sin(4 * t)])


def sines(t: np.ndarray, size: ArrayLike, speed: ArrayLike, phase: ArrayLike) -> Motion:
    """Each joint to and fro: size [rad], speed [rad/s] and phase [rad] of each, or of all."""
    angle = t[:, None] * speed + phase
    q, rate = size * np.sin(angle), np.multiply(size, speed)
    return Motion(t, q, rate * np.cos(angle), -rate * speed * np.sin(angle))


def swinging(
    arm: NominalArm,
    rng: np.random.Generator,
    centre: np.ndarray,
    *,
    duration: float,
    frequency: float,
    speed: float = 1.2,
    acceleration: float = 5.0,
) -> Fourier:
    """A smooth motion about a posture within the limits of the arm's file, and at most so fast [rad/s, rad/s^2]."""
    limits = urdf_limits(RigidBody(arm), acceleration)
    limits = limits._replace(velocity=np.full(arm.n_joints, speed))
    how = {"duration": duration, "centre": centre, "frequency": frequency}
    return Fourier.random(rng, limits, **how)


def case_of(
    name: str,
    arm: NominalArm,
    *recordings: Recording,
    folder: Path = Path(),
    **more: Any,
) -> Case:
    """A case of some recordings."""
    return Case(name, folder, arm, recordings, **more)


def simulated_case(
    folder: Path,
    name: str,
    arm: NominalArm,
    effects: Effects,
    *,
    seed: int,
    frequencies: Sequence[float],
    duration: float,
    rate: float,
    noise: float,
) -> Case:
    """A case from the corrected arm: motions of these lowest frequencies [Hz], noise of the torque [N m]."""
    body, n = RigidBody(arm), arm.n_joints
    rng, t = np.random.default_rng(seed), np.arange(round(duration * rate) + 1) / rate
    recordings = []
    for k, frequency in enumerate(frequencies):
        reference = Fourier.random(
            rng, limits(n, 2.0, 2.0, 8.0), duration=duration, frequency=frequency
        )
        seen = motion_of(reference, t)
        tau = CorrectedArm(arm, effects).predict(body, seen)
        tau = tau + noise * rng.standard_normal((len(t), n))
        recordings.append(Recording(f"recording_{k}.csv", t, seen.q, tau))
    return case_of(name, arm, *recordings, folder=folder)


def each(case: Case, change: Callable[[Recording], Recording]) -> Case:
    """A case with every recording changed."""
    return replace(case, recordings=tuple(change(r) for r in case.recordings))


def changed_during(
    name: str,
    folder: Path,
    later: dict[str, tuple[float, Effects]],
    *names: str,
    arm: NominalArm | None = None,
) -> Case:
    """Recordings of the iiwa or some of its joints, in those of ``later`` with other effects from a moment [s] on."""
    arm, rng = arm or iiwa(), np.random.default_rng(2)
    posture = POSTURE[[int(joint[-1]) - 1 for joint in arm.joints]]
    controller, space = position_controller(arm, posture), workspace(RigidBody(arm))
    recordings = tuple(
        record(
            arm,
            (),
            draw_motion("fourier", rng, space, 8.0),
            controller,
            duration=8.0,
            rng=rng,
            torque_noise=0.1,
            name=recording,
            later=later.get(recording),
        )
        for recording in names
    )
    return Case(name, folder, arm, recordings, controller=controller)


@cache
def panda_body() -> RigidBody:
    """Rigid bodies of ``tooled_panda``."""
    return RigidBody(tooled_panda())


def panda_motion(
    seed: int, *, size: float = 1.5, speed: float = 1.5, duration: float = 10.0
) -> Fourier:
    """A smooth motion of all joints, up to ``size`` [rad] and ``speed`` [rad/s]."""
    return Fourier.random(
        np.random.default_rng(seed),
        limits(7, size, speed, 5.0 * speed),
        duration=duration,
        frequency=0.2,
    )


def panda_recording(
    name: str, seed: int, effects: Effects = (), noise: float = 0.01, **how: float
) -> Recording:
    """What ``tooled_panda`` logs at 250 Hz; noise of the torque over its standard deviation."""
    reference, rate = panda_motion(seed, **how), 250.0
    t = np.arange(round(reference.duration * rate) + 1) / rate
    corrected = CorrectedArm(tooled_panda(), effects)
    q = reference.position(t) + corrected.value("encoder_offset", "offset")
    seen = Motion(t, q, reference.velocity(t), reference.acceleration(t))
    tau = corrected.predict(panda_body(), seen)
    rng = np.random.default_rng(1000 + seed)
    tau = tau + noise * tau.std(axis=0) * rng.standard_normal(tau.shape)
    return Recording(name, t, q, tau)


def panda_case(
    effects: Effects = (), seed: int = 0, count: int = 2, **how: float
) -> Case:
    """A case of some of them, the last of which is judged on."""
    recordings = (
        panda_recording(f"recording_{k}.csv", 10 * seed + k, effects, **how)
        for k in range(count)
    )
    return case_of("panda", tooled_panda(), *recordings)


def untrained_network(n: int) -> ResidualNetwork:
    """A residual network that was never trained: additive on the even joints, an MLP on the odd ones."""
    rng, taps, members = np.random.default_rng(0), 4, 3
    c, near = Layout(n).channels, len(Layout(n).neighbourhood)
    inputs = Inputs(n, taps, 0.02, np.zeros((n, c)), np.ones((n, c)))
    sizes = [(len(inputs.seen_by_mlp), 5), (5, 2)]
    weights = tuple(rng.standard_normal((members, n, a, b)) for a, b in sizes)
    biases = tuple(rng.standard_normal((members, n, b)) for _, b in sizes)
    basis = draw_basis(-np.ones((n, c)), np.ones((n, c)), 0)
    head = 0.1 * rng.standard_normal((members, n, len(part_of_each(basis)), 2))
    trust = Trust(rng.standard_normal((n, 6, near)), np.full(n, 50.0))
    return ResidualNetwork(
        inputs,
        (
            Network("additive", np.zeros(0, int), (head,), (biases[1],), basis),
            Network("mlp", inputs.seen_by_mlp, weights, biases),
        ),
        np.arange(n) % 2,
        trust,
        np.ones(n),
        np.full(n, 2.0),
        12.0,
    )


def valid_document(file: Path) -> dict[str, Any]:
    """The document in a file, valid by the schema of its name."""
    content = json.loads(file.read_text(encoding="utf-8"))
    check_document(content, file.stem)
    return content
