"""Laws that act through the positions, and faults of the set-up, for the benchmark of real arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from real_motion import filtered
from real_scene import Law, Scene, Values, no_values, on_joints

from gapscope.arm.recording import Recording

LOAD_BAND = 8.0
"""The torque through a transmission is taken below this frequency [Hz]."""
HARDENING = 0.25
"""Share by which a spring of a gear is stiffer at the largest torque [1]."""
DAMPING = 0.1
"""Damping ratio of a joint's inertia on its spring [1]."""
SOFT_FLANK = 0.04
"""Torque over the largest at which free play is closed to three quarters [1]."""
DITHER = 0.15
"""Noise before rounding, over the step [1]."""
STEPS = {2.5: 5e-4, 4.0: 1e-3, 8.0: 2e-3}
"""Quantisation step of an encoder by size [rad]."""
UNITS = ("degrees", "milliseconds", "motor_side")
"""Kinds of wrong units."""


def load(scene: Scene) -> np.ndarray:
    """Torque through the transmissions [N m], (N, n): what the identified bodies need, without noise of sensors."""
    return filtered(scene.rigid(scene.true_body), scene.rate, LOAD_BAND)


def friction(scene: Scene, velocity: np.ndarray) -> np.ndarray:
    """Friction of the identified arm [N m] at velocities [rad/s], (N, n)."""
    arm = scene.truth
    return arm.coulomb * np.tanh(velocity / 0.005) + arm.viscous * velocity


def motor_moved(
    scene: Scene, recording: Recording, joints: np.ndarray, twist: np.ndarray
) -> Recording:
    """A recording whose encoders sit on motors that lead the joints by a twist [rad], (N, n).

    The joints move as the carrier's; the motors' rotors and friction need another torque.
    """
    twist = on_joints(twist, joints)
    rate = np.gradient(twist, recording.t, axis=0, edge_order=2)
    bend = np.gradient(rate, recording.t, axis=0, edge_order=2)
    extra = scene.truth.armature * bend
    extra = extra + friction(scene, scene.dq + rate) - friction(scene, scene.dq)
    dq = None if recording.dq is None else recording.dq + rate
    tau = np.asarray(recording.tau) + extra
    return replace(recording, q=recording.q + twist, dq=dq, tau=tau)


def elasticity(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """A spring that hardens by a quarter; x is the compliance [rad/kN m], the stiffness that of least squares."""
    torque = load(scene)[:, joints]
    largest = np.abs(torque).max(axis=0)
    spring = 1e-3 * x * torque / (1 + HARDENING * (torque / largest) ** 2)
    compliance = (spring * torque).sum(axis=0) / (torque**2).sum(axis=0)
    inertia = scene.inertia[joints]
    damping = 2 * DAMPING * np.sqrt(inertia / compliance)
    # with the damper beside it the spring follows its torque late, by so little that the first order does
    rate = np.gradient(spring, recording.t, axis=0, edge_order=2)
    twist = np.zeros_like(scene.dq)
    twist[:, joints] = spring - damping * compliance * rate
    truth = {"stiffness": 1 / compliance, "damping": damping}
    return motor_moved(scene, recording, joints, twist), truth


def backlash(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Free play that closes smoothly, w / 2 tanh(tau / T)."""
    torque = load(scene)
    soft = SOFT_FLANK * np.abs(torque).max(axis=0)
    twist = np.zeros_like(torque)
    twist[:, joints] = 0.5 * x * np.tanh(torque / soft)[:, joints]
    return motor_moved(scene, recording, joints, twist), {"width": x}


def encoder_offset(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Positions shifted."""
    q = np.array(recording.q)
    q[:, joints] += x
    return replace(recording, q=q), {"offset": x}


def draw_dither(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Noise before rounding [1], (N, n)."""
    return {"noise": rng.uniform(-DITHER, DITHER, scene.recording.q.shape)}


def quantization(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Positions rounded to steps, with dither."""
    q = np.array(recording.q)
    noise = drawn["noise"][: len(q), joints]
    q[:, joints] = np.round(q[:, joints] / x + noise) * x
    return replace(recording, q=q), {"step": x}


def sign_flip(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """The torque of a joint turned round."""
    tau = np.array(recording.tau)
    tau[:, joints] *= -1
    return replace(recording, tau=tau), {}


def joint_swap(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """The torques of two joints exchanged."""
    tau = np.array(recording.tau)
    tau[:, joints] = tau[:, joints[::-1]]
    return replace(recording, tau=tau), {}


def draw_unit(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The kind of unit, and a gear ratio [1]."""
    return {"unit": str(rng.choice(UNITS)), "ratio": float(rng.integers(50, 161))}


def unit_mismatch(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Degrees, milliseconds, or the motors' side of the gears."""
    truth = {"unit": drawn["unit"]}
    if drawn["unit"] == "milliseconds":
        return replace(recording, t=1e3 * recording.t), truth
    degrees = drawn["unit"] == "degrees"
    factor = 180 / np.pi if degrees else drawn["ratio"]
    dq = None if recording.dq is None else factor * recording.dq
    tau = np.asarray(recording.tau) / (1.0 if degrees else drawn["ratio"])
    return replace(recording, q=factor * recording.q, dq=dq, tau=tau), truth


LAWS = (
    Law("joint_elasticity", "a hardening spring", 2, no_values, elasticity, 0.1, "stiffness", motor=True),
    Law("backlash", "free play that closes smoothly", 2, no_values, backlash, 0.005, "width", motor=True),
    Law("encoder_offset", "the same", 6, no_values, encoder_offset, 0.03, "offset", "spread", True),
    Law("encoder_quantization", "with dither", 6, draw_dither, quantization, 1e-3, "step", "none"),
    Law("sign_flip", "torque of a joint", 7, no_values, sign_flip, place="none"),
    Law("joint_swap", "torque of neighbours", 7, no_values, joint_swap, place="none"),
    Law("unit_mismatch", "degrees, milliseconds, motor side", 7, draw_unit, unit_mismatch, place="none"),
)  # fmt: skip
"""The laws."""
