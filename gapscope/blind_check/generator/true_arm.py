"""The true arm: its parameters joint by joint, and the control loop that is compiled with them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from gapscope.blind_check.generator.arms import Arm
from gapscope.blind_check.generator.joint import FIELDS, JOINT, MAX_JOINTS, njit
from gapscope.blind_check.generator.rigid import GRAVITY

# The sampled controller: encoders, velocity filter, PD law with feedforward; compiled by numba.


FILTER = np.dtype([(name, "f8", (MAX_JOINTS,)) for name in ("x1", "x2", "y1", "y2")])
"""Memory of the velocity filter: its inputs x and outputs y of the last two ticks."""


class Loop(NamedTuple):
    """A PD controller, n joints.

    Attributes:
        rate: [Hz].
        kp, kd: gains [N m/rad, N m s/rad], (n,).
        limit: largest command [N m], (n,).
        cutoff, damping: of the velocity filter s w^2 / (s^2 + 2 z w s + w^2) [Hz, 1].
        feedforward: ``none``, ``gravity`` or ``nominal``.
    """

    rate: float
    kp: np.ndarray
    kd: np.ndarray
    limit: np.ndarray
    cutoff: float
    damping: float
    feedforward: str

    def coefficients(self) -> np.ndarray:
        """b0, a1, a2 of the filter by Tustin's rule: y = b0 (x - x_-2) - a1 y_-1 - a2 y_-2."""
        w, k = 2 * np.pi * self.cutoff, 2.0 * self.rate
        a0 = k * k + 2 * self.damping * w * k + w * w
        b0 = k * w * w
        a1 = 2 * w * w - 2 * k * k
        a2 = k * k - 2 * self.damping * w * k + w * w
        return np.array([b0, a1, a2]) / a0


@njit(cache=True)
def encoder_reading(p, s, i, q, noise):  # type: ignore[no-untyped-def]
    """What the encoder of joint i reads [rad]: the motor's side of a compliant joint, offset, noisy and rounded."""
    true = s.theta[i] if p.stiffness[i] > 0.0 else q[i]
    x = true + p.encoder[i] * (1.0 + p.eccentric[i] * np.sin(true)) + noise[i]
    return np.round(x / p.step[i]) * p.step[i]


@njit(cache=True)
def filtered_velocity(m, i, filt, x):  # type: ignore[no-untyped-def]
    """Velocity of joint i [rad/s] from its reading x [rad]; moves the filter's memory."""
    y = filt[0] * (x - m.x2[i]) - filt[1] * m.y1[i] - filt[2] * m.y2[i]
    m.x2[i] = m.x1[i]
    m.x1[i] = x
    m.y2[i] = m.y1[i]
    m.y1[i] = y
    return y


@njit(cache=True)
def command(par, state, memory, filt, q, given, out):  # type: ignore[no-untyped-def]
    """One tick: what the encoders read, the filtered velocity, and the command; returns how many joints clipped.

    Args:
        par, state, memory: records of ``JOINT``, ``STATE`` and ``FILTER``, as arrays of length 1.
        filt: b0, a1, a2.
        q: of the links [rad], (n,).
        given: rows of the encoders' noise [rad], the reference [rad, rad/s] and the feedforward [N m], (4, n).
        out: rows q, dq, tau, (3, n), written to.
    """
    p, s, m = par[0], state[0], memory[0]
    clipped = 0
    for i in range(p.n):
        x = encoder_reading(p, s, i, q, given[0])
        if np.isnan(m.x1[i]):  # the first tick
            m.x1[i] = x
            m.x2[i] = x
        y = filtered_velocity(m, i, filt, x)
        u = given[3, i] + p.kp[i] * (given[1, i] - x) + p.kd[i] * (given[2, i] - y)
        if abs(u) > p.limit[i]:
            clipped += 1
            u = p.limit[i] if u > 0 else -p.limit[i]
        out[0, i] = x
        out[1, i] = y
        out[2, i] = u
    return clipped


# The true arm of a case while it is put together: causes change it, the simulation runs it.


Columns = dict[str, np.ndarray]
"""A recording: t [s] (N,), and q, dq, tau, q_ref, dq_ref of shape (N, n)."""
Spoil = Callable[[Columns, np.random.Generator], Columns]
"""What a fault of the set-up makes of a recording."""
Resistance = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Torque against the motors [N m], (n,), from time [s], positions [rad], velocities [rad/s] and motor torque [N m]."""
TipForce = Callable[[float, np.ndarray, np.ndarray], np.ndarray]
"""Force on the tip in the world [N], (3,), from time [s] and the tip's position [m] and velocity [m/s]."""


class HealthyArm(NamedTuple):
    """What a healthy arm of a case is, beside its data sheet; n joints.

    Attributes:
        step: simulation step [s].
        encoder_step: quantisation of the encoders [rad].
        noise: standard deviation of the encoders [rad].
        stribeck, knee: rise of dry friction at rest [1] and its speed [rad/s], (n,).
        presliding: way before dry friction slides [rad].
        bend: exponent of viscous friction [1], (n,).
    """

    step: float
    encoder_step: float
    noise: float
    stribeck: np.ndarray
    knee: np.ndarray
    presliding: float
    bend: np.ndarray


@dataclass
class TrueArm:
    """An arm in the making, n joints.

    Attributes:
        arm: the arm that the data sheet describes.
        healthy: its small imperfections.
        loop: its controller.
        root: URDF of the true arm.
        values: fields of ``JOINT``, each of shape (n,).
        gravity: in the base frame [m/s^2], (3,).
        push: force on the tip, or none.
        shaken: amplitude of the base's acceleration [m/s^2], (3,), with frequency [Hz] and phase [rad]; or none.
        resisting: further torques against the motors.
        spoil: faults of the set-up, in turn.
        spoil_urdf: a fault of the nominal arm's URDF.
    """

    arm: Arm
    healthy: HealthyArm
    loop: Loop
    root: ET.Element
    values: dict[str, np.ndarray] = field(default_factory=dict)
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -GRAVITY]))
    push: TipForce | None = None
    shaken: tuple[np.ndarray, float, float] | None = None
    resisting: list[Resistance] = field(default_factory=list)
    spoil: list[Spoil] = field(default_factory=list)
    spoil_urdf: Callable[[ET.Element], None] | None = None

    def __post_init__(self) -> None:
        """Fill in what a healthy arm has."""
        arm, own = self.arm, self.healthy
        # divisors of laws that are switched off
        ones = (
            "fall_speed",
            "fall_power",
            "level_speed",
            "level_power",
            "drift_time",
            "drift_power",
            "peak",
            "fade_time",
            "fade_load",
            "reach",
        )
        given: dict[str, Any] = {
            **dict.fromkeys(FIELDS, 0.0),
            **dict.fromkeys(ones, 1.0),
            "kp": self.loop.kp,
            "kd": self.loop.kd,
            "limit": self.loop.limit,
            "armature": arm.armature,
            "coulomb": arm.coulomb,
            "viscous": arm.viscous,
            "bend": own.bend,
            "stribeck": own.stribeck,
            "knee": own.knee,
            "step": own.encoder_step,
            "clamp": 1e9,
        }
        self.values = {name: np.full(arm.n, value) for name, value in given.items()}

    def add(self, name: str, joints: np.ndarray, value: np.ndarray | float) -> None:
        """Add to a value of some joints (counted from 0)."""
        self.values[name][joints] += value

    def put(self, name: str, joints: np.ndarray, value: np.ndarray | float) -> None:
        """Set a value of some joints (counted from 0)."""
        self.values[name][joints] = value

    def record(self) -> np.ndarray:
        """The joints as the compiled step wants them: a ``JOINT`` array of length 1."""
        out = np.zeros(1, dtype=JOINT)
        n, h, values = self.arm.n, self.healthy.step, self.values
        for name in FIELDS:
            out[name][0, :n] = values[name]
        armature = values["armature"]
        at_rest = np.maximum(values["coulomb"] + values["fall"], 1e-3)
        stiffest = 0.2 * armature / h**2  # a bristle that the step can follow
        bristle = np.minimum(at_rest / self.healthy.presliding, stiffest)
        out["bristle"][0, :n] = bristle
        out["bristle_damping"][0, :n] = 0.6 * np.sqrt(bristle * armature)
        out["delay"][0, :n] = np.round(values["delay"] / h)
        out["h"] = h
        out["n"] = n
        return out
