"""Laws of the path from torque to joint, of mounting, springs and forces, for the benchmark of real arms.

applied = (1 + s) recorded + offset + ripple, with applied the torque that the carrier recorded: what its body needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from real_motion import filtered
from real_scene import (
    Law,
    Scene,
    Values,
    added,
    amount,
    no_values,
    on_joints,
    shortened,
)

from gapscope.arm.recording import Recording

CURVATURE = 0.15
"""How much of a torque constant's error is lost at the largest torque [1]."""
OFFSET_DRIFT = 0.08
"""How much an offset changes over a recording [1]."""
SECOND_HARMONIC = 0.25
"""Second harmonic of a ripple over the first [1]."""
LAG_BAND = 15.0
"""Derivatives of the torque are taken below this frequency [Hz]."""
SLOWEST_PERIODS, FASTEST_RIPPLE = 3.0, 6.0
"""A ripple has so many periods within the motion, and no more than so many per second at the RMS speed [1], [Hz]."""


def turned_gravity(gravity: np.ndarray, roll: float, pitch: float) -> np.ndarray:
    """Gravity in a base turned by R = Ry(pitch) Rx(roll), R^T g [m/s^2], (3,)."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return (about_y @ about_x).T @ gravity


def draw_direction(
    scene: Scene, rng: np.random.Generator, joints: np.ndarray
) -> Values:
    """Direction of the axis in the floor about which the base is turned [rad]."""
    return {"direction": float(rng.uniform(-np.pi, np.pi))}


def base_tilt(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Gravity turned, on the bodies that were identified on the whole carrier."""
    roll = float(x) * np.cos(drawn["direction"])
    pitch = float(x) * np.sin(drawn["direction"])
    gravity = turned_gravity(scene.truth.gravity, roll, pitch)
    body = scene.true_body
    turned = body.changed(np.zeros((scene.n, 10)), gravity)
    torque = scene.rigid(turned) - scene.rigid(body)
    truth = {"roll": roll, "pitch": pitch}
    return added(recording, torque, link_side=True), truth


def draw_rest(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Where the spring is slack [rad]."""
    q = scene.recording.q[:, joints]
    middle, half = (q.max(axis=0) + q.min(axis=0)) / 2, np.ptp(q, axis=0) / 2
    return {"rest": middle + rng.uniform(-0.7, 0.7, len(joints)) * half}


def spring(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """K (q - q0) (1 + 0.15 (q - q0)^2 / the largest), stiffness and rest by least squares."""
    stretch = scene.recording.q[:, joints] - drawn["rest"]
    cubic = stretch**3 / (stretch**2).max(axis=0)
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = x * (stretch + 0.15 * cubic)
    stiffness, rest = np.empty(len(joints)), np.empty(len(joints))
    for k, joint in enumerate(joints):
        q = scene.recording.q[:, joint]
        slope, level = np.polyfit(q, torque[:, joint], 1)
        stiffness[k], rest[k] = slope, -level / slope
    truth = {"stiffness": stiffness, "rest": rest}
    return added(recording, torque, link_side=True), truth


def draw_force(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Direction, begin and end of a push [1], [s]."""
    direction = rng.standard_normal(3)
    duration = scene.recording.duration
    start = float(rng.uniform(0.15, 0.5) * duration)
    length = float(rng.uniform(0.2, 0.35) * duration)
    unit = direction / np.linalg.norm(direction)
    return {"direction": unit, "start": start, "end": start + length}


def external_force(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """A push that rises and falls by cosines over a fifth of its time; the force that fits best within its time."""
    t, start, end = recording.t, drawn["start"], drawn["end"]
    edge = 0.2 * (end - start)
    rise = np.clip((t - start) / edge, 0, 1) * np.clip((end - t) / edge, 0, 1)
    shape = 0.5 - 0.5 * np.cos(np.pi * rise)
    inside = (t >= start) & (t <= end)
    force = float(x) * drawn["direction"]
    position = np.asarray(scene.recording.q)
    torque = scene.nominal_body.force_torque(position, force)
    mean = (shape[inside] * (torque[inside] ** 2).sum(axis=1)).sum()
    share = float(mean / (torque[inside] ** 2).sum())
    truth = {"force": share * force, "start": start, "end": end}
    return added(recording, -shape[:, None] * torque, link_side=True), truth


def scale(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """applied = (1 + s (1 - 0.15 (u / largest)^2)) u, solved for the recorded u; s by least squares."""
    applied = np.asarray(recording.tau)[:, joints]
    largest = np.abs(applied).max(axis=0)
    u = applied / (1 + x)
    for _ in range(30):
        u = applied / (1 + x * (1 - CURVATURE * (u / largest) ** 2))
    tau = np.array(recording.tau)
    tau[:, joints] = u
    return replace(recording, tau=tau), {"scale": amount(u, applied) - 1}


def offset(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """An offset that drifts by 8 % over the recording; its mean."""
    drift = 1 + OFFSET_DRIFT * (recording.t / recording.duration - 0.5)
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = -x * drift[:, None]
    return added(recording, torque), {"torque": x}


def draw_ripple(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Whole periods per revolution that the motion shows and 12 Hz let through, and phases [rad]."""
    swing = np.ptp(scene.recording.q[:, joints], axis=0)
    low = np.maximum(2 * np.pi * SLOWEST_PERIODS / swing, 2.0)
    high = 2 * np.pi * FASTEST_RIPPLE / np.maximum(scene.speed[joints], 1e-3)
    high = np.clip(high, low, 200.0)
    cycles = np.round(low * (high / low) ** rng.uniform(0, 1, len(joints)))
    phases = rng.uniform(0, 2 * np.pi, (2, len(joints)))
    return {"cycles": cycles, "phase": phases[0], "second": phases[1]}


def ripple(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """A (sin(n q + phi) + sin(2 n q + phi') / 4)."""
    angle = drawn["cycles"] * scene.recording.q[:, joints]
    wave = np.sin(angle + drawn["phase"])
    wave = wave + SECOND_HARMONIC * np.sin(2 * angle + drawn["second"])
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = -x * wave
    truth = {"amplitude": x, "cycles": drawn["cycles"], "phase": drawn["phase"]}
    return added(recording, torque), truth


def delay(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """recorded(t) = applied(t + T), by linear interpolation; the last samples have no torque and are left out."""
    tau = np.array(recording.tau)
    for joint, time in zip(joints, x, strict=True):
        tau[:, joint] = np.interp(recording.t + time, recording.t, tau[:, joint])
    changed = replace(recording, tau=tau)
    last = recording.t[-1] - x.max()
    count = int((recording.t <= last).sum())
    return shortened(changed, count), {"delay": x}


def draw_lag(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Share of the second time constant [1]."""
    return {"second": float(rng.uniform(0.0, 0.3))}


def lag(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Two lags one after the other, inverted below 15 Hz; the sum of their time constants.

    Of the torque that the identified arm predicts: the noise of what was recorded did not pass the lags.
    """
    first, second = x * (1 - drawn["second"]), x * drawn["second"]
    torque = filtered(scene.healthy_torque, scene.rate, LAG_BAND)
    rate = np.gradient(torque, recording.t, axis=0, edge_order=2)
    bend = np.gradient(rate, recording.t, axis=0, edge_order=2)
    extra = np.zeros_like(torque)
    extra[:, joints] = x * rate[:, joints] + first * second * bend[:, joints]
    return added(recording, on_joints(extra, joints)), {"time_constant": x}


LAWS = (
    Law("base_tilt", "gravity turned on identified bodies", 0, draw_direction, base_tilt, 0.05, "", "arm"),
    Law("parallel_spring", "slightly cubic", 0, draw_rest, spring, 5.0, "stiffness"),
    Law("external_force", "rises and falls by cosines", 0, draw_force, external_force, 20.0, "force", "arm"),
    Law("torque_offset", "drifts by 8 %", 3, no_values, offset, 1.0, "torque", signed=True),
    Law("torque_ripple", "with a second harmonic", 3, draw_ripple, ripple, 0.5, "amplitude"),
    Law("torque_scale", "less by 15 % at the largest torque", 4, no_values, scale, 0.1, "scale", signed=True),
    Law("actuator_lag", "two lags in a row", 5, draw_lag, lag, 0.01, "time_constant"),
    Law("actuator_delay", "linear interpolation", 5, no_values, delay, 0.01, "delay"),
)  # fmt: skip
"""The laws."""
