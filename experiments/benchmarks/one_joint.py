"""A pendulum with friction and a rotor under PD control, simulated apart from the project and from MuJoCo.

I ddq = tau - g (x sin q + z cos q) - b dq - c s - o with s in sgn(dq), set-valued at rest. Each step solves for the
velocity at its end with dry friction implicit, so that the joint sticks exactly: v = S(v0 + h f / I', h c / I'), S the
soft threshold and I' = I + h b. The controller is sampled; it differentiates a noisy encoder backward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

GRAVITY = 9.81
MASS, LEVER, LINK_INERTIA = 2.0, 0.15, 0.02
"""Of the link [kg], its centre of mass from the axis [m], inertia about its centre of mass [kg m^2]."""
TRUTH = {"inertia": 0.12, "viscous": 0.25, "coulomb": 0.4}
"""Inertia about the axis with the rotor [kg m^2], friction [N m s/rad], [N m]."""
OFFSET = 0.1
"""Constant torque that the sensor shows and the joint does not feel [N m]."""
KP, KD = 30.0, 2.0
"""Gains [N m/rad], [N m s/rad]."""
RATE, SUBSTEPS = 1000.0, 20
"""Of controller and recording [Hz], and steps of the simulation in each period."""
ENCODER_NOISE = 1e-5
"""[rad]"""
HARMONICS, BASE_FREQUENCY, REACH = 5, 0.2, 1.2
"""Of the reference, its lowest frequency [Hz], its largest position [rad]."""


@dataclass(frozen=True)
class OneJoint:
    """A recording: time [s], reference and its velocity, measured position [rad], commanded torque [N m]."""

    t: np.ndarray
    q_ref: np.ndarray
    dq_ref: np.ndarray
    q: np.ndarray
    tau: np.ndarray

    @property
    def columns(self) -> Mapping[str, np.ndarray]:
        """Its series by name."""
        return vars(self)


def recorded(seconds: float, rng: np.random.Generator) -> OneJoint:
    """A recording of a random motion."""
    t = np.arange(int(seconds * RATE)) / RATE
    q_ref, dq_ref = _reference(t, rng)
    noise = ENCODER_NOISE * rng.standard_normal(len(t))
    q, tau = _closed_loop(q_ref, dq_ref, noise)
    return OneJoint(t, q_ref, dq_ref, q, tau)


def _reference(
    t: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A Fourier series that begins at rest at zero."""
    w = 2 * np.pi * BASE_FREQUENCY * np.arange(1, HARMONICS + 1)
    sine, cosine = rng.standard_normal((2, HARMONICS)) / np.arange(1, HARMONICS + 1)
    series = np.sin(np.outer(t, w)) @ sine + np.cos(np.outer(t, w)) @ cosine
    # blended in over a second, with its derivative taken of the samples
    ramp = np.clip(t, 0.0, 1.0)
    series *= 3 * ramp**2 - 2 * ramp**3
    series *= REACH / np.abs(series).max()
    return series, np.gradient(series, 1 / RATE)


def _closed_loop(
    q_ref: np.ndarray, dq_ref: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measured position and commanded torque at each tick."""
    h = 1 / (RATE * SUBSTEPS)
    inertia = TRUTH["inertia"] + h * TRUTH["viscous"]
    dry = h * TRUTH["coulomb"] / inertia
    q, v, last = 0.0, 0.0, noise[0]
    measured, torque = np.empty_like(q_ref), np.empty_like(q_ref)
    for k in range(len(q_ref)):
        measured[k] = encoder = q + noise[k]
        rate, last = (encoder - last) * RATE, encoder
        torque[k] = KP * (q_ref[k] - encoder) + KD * (dq_ref[k] - rate)
        for _ in range(SUBSTEPS):
            force = torque[k] - MASS * GRAVITY * LEVER * np.sin(q) - OFFSET
            # without dry friction the step would end with this velocity
            free = (TRUTH["inertia"] * v + h * force) / inertia
            v = np.sign(free) * max(abs(free) - dry, 0.0)
            q += h * v
    return measured, torque


def write_urdf(path: Path) -> Path:
    """The pendulum without rotor and friction, hanging along -z and turning about y."""
    across = LINK_INERTIA
    path.write_text(
        f"""<robot name="pendulum"><link name="base"/>
  <link name="bob"><inertial><origin xyz="0 0 {-LEVER}"/><mass value="{MASS}"/>
    <inertia ixx="{across}" iyy="{across}" izz="{across / 10}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint" type="revolute"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="20"/></joint></robot>
""",
        encoding="utf-8",
    )
    return path
