"""Laws of the benchmark of real arms: those of the package, and more of the same form, with faults of the set-up.

``gapscope.blind_check.generator.recorded`` says what a law is; all that are here enter ``LAWS``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import curve_fit

from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.generator import recorded
from gapscope.blind_check.generator.laws import UNITS, in_other_units
from gapscope.blind_check.generator.recorded import (
    RECORDED_LAWS,
    Changed,
    Put,
    RecordedLaw,
    Values,
    amount,
    body_parameters,
    filtered,
    nothing,
    with_body,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

LOAD_BAND = 8.0
"""The torque through a transmission is taken below this frequency [Hz]."""


@dataclass(frozen=True)
class Scene(recorded.Scene):
    """One piece of a carrier, N samples of n joints, healthy.

    Attributes:
        residual: RMS that a full model leaves on this arm [N m], (n,).
    """

    residual: np.ndarray

    @cached_property
    def torque(self) -> np.ndarray:
        """Recorded torque below 12 Hz [N m], (N, n)."""
        return filtered(self.recording.tau, self.rate, TORQUE_CUTOFF)

    @cached_property
    def load(self) -> np.ndarray:
        """Torque through the transmissions, without noise of sensors: what the bodies need [N m], (N, n)."""
        return filtered(self.rigid(self.true_body), self.rate, LOAD_BAND)

    def gap(self, changed: Recording) -> np.ndarray:
        """RMS by which the torque gap changes with a recording, as ``torque_nrmse`` sees it [N m], (n,).

        Below 12 Hz and without the ends: the change of the torque less that of the torque that the positions ask for.
        """
        count = len(changed.t)
        change = changed.tau - self.recording.tau[:count]
        if not np.array_equal(changed.q, self.recording.q[:count]):
            healthy = self.needed(self.recording)[:count]
            change = change - self.needed(changed) + healthy
        edge = int(np.ceil(TRIM * self.rate))
        kept = low_pass(change, self.rate, TORQUE_CUTOFF)[edge:-edge]
        return rms(kept)


SELF_LOCKED = 1e4
"""Torque at which a joint counts as locked by its own friction [N m]."""
LOAD_ROUNDS = 60
"""Times that friction and the torque which overcomes it are put into each other."""
SECOND_HARMONIC = 0.25
"""Second harmonic of a ripple over the first [1]."""
SLOWEST_PERIODS, FASTEST_RIPPLE = 3.0, 6.0
"""A ripple has so many periods within the motion, and no more than so many per second at the RMS speed [1], [Hz]."""


def _stribeck(put: Put) -> Changed:
    """D sgn v / (1 + (v / vs)^2); the catalogue has a Gaussian."""
    torque = put.x * smooth_sign(put.v) / (1 + (put.v / put["velocity"]) ** 2)

    def gauss(v: np.ndarray, d: float, vs: float) -> np.ndarray:
        return d * np.exp(-((v / vs) ** 2)) * smooth_sign(v)

    starts = np.column_stack([put.x, put["velocity"]])
    each = zip(put.v.T, torque.T, starts, strict=True)
    fits = [curve_fit(gauss, *one, maxfev=2000)[0] for one in each]
    found, velocity = np.transpose(fits)
    return put.added(torque), {"torque": found, "velocity": np.abs(velocity)}


def _load_friction(put: Put) -> Changed:
    """Mu T (abs tau / T)^p tanh(v / w), T the mean load; tau, the motor's torque, overcomes this friction too."""
    without, mean = put.scene.torque[:, put.joints], put["load"]
    direction = np.tanh(put.v / (0.02 * put["speed"]))
    motor = without
    for _ in range(LOAD_ROUNDS):
        law = put.x * mean * (np.abs(motor) / mean) ** put["power"] * direction
        # a joint that locks itself has no finite torque, and is no case
        motor = np.clip(without + law, -SELF_LOCKED, SELF_LOCKED)
    form = np.abs(motor) * smooth_sign(put.v)
    return put.added(law), {"coefficient": amount(form, law)}


def _drift(put: Put) -> Changed:
    """Friction of the true arm times a warm-up: linear to zero, or two exponentials."""
    t, time = put.recording.t, put["time"]
    fade = 0.7 * np.exp(-t / (0.6 * time)) + 0.3 * np.exp(-t / (2 * time))
    if put["form"] == "linear":
        fade = np.clip(1 - t / (2 * time), 0.0, 1.0)
    friction = put.scene.truth.friction(put.scene.dq)[:, put.joints]

    def exponential(at: np.ndarray, a: float, constant: float) -> np.ndarray:
        return a * np.exp(-at / constant)

    fit, _ = curve_fit(exponential, t, fade, (1.0, time), maxfev=2000)
    constants = np.full(len(put.joints), fit[1])
    truth = {"amplitude": put.x * fit[0], "time_constant": constants}
    return put.added(friction * fade[:, None] * put.x), truth


def _link_inertia(put: Put) -> Changed:
    """A link of another size at the same density: its inertia grows with the power 5/3 of its mass."""
    body, place, more = put.scene.nominal_body, put["link"], np.ravel(put.x)[0]
    own = body.model.inertias[int(body.links[place])]
    mass = own.mass + more
    growth = (max(mass, 1e-3) / max(own.mass, 1e-3)) ** (5 / 3)
    new = body_parameters(mass, own.lever + put["com"], own.inertia * growth)
    truth = {"link": place + 1, "mass": more, "com": put["com"]}
    return with_body(put, place, new - own.toDynamicParameters()), truth


def _draw_force(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """Direction, begin and end of a push [1], [s]."""
    direction, duration = rng.standard_normal(3), scene.recording.duration
    start = float(rng.uniform(0.15, 0.5) * duration)
    end = start + float(rng.uniform(0.2, 0.35) * duration)
    unit = direction / np.linalg.norm(direction)
    return {"direction": unit, "start": start, "end": end}


def _external_force(put: Put) -> Changed:
    """A push that rises and falls by cosines over a fifth of its time; the force that fits best within its time."""
    t, start, end = put.recording.t, put["start"], put["end"]
    edge = 0.2 * (end - start)
    rise = np.clip((t - start) / edge, 0, 1) * np.clip((end - t) / edge, 0, 1)
    shape = 0.5 - 0.5 * np.cos(np.pi * rise)
    force = np.ravel(put.x)[0] * put["direction"]
    position = put.scene.recording.q
    torque = put.scene.nominal_body.force_torque(position, force)
    power = (torque**2).sum(axis=1) * ((t >= start) & (t <= end))
    share = float((shape * power).sum() / power.sum())
    truth = {"force": share * force, "start": start, "end": end}
    return put.added(-shape[:, None] * torque, link_side=True), truth


def _draw_ripple(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """Whole periods per revolution that the motion shows and 12 Hz let through, and phases [rad]."""
    swing = np.ptp(scene.recording.q[:, joints], axis=0)
    low = np.maximum(2 * np.pi * SLOWEST_PERIODS / swing, 2.0)
    high = 2 * np.pi * FASTEST_RIPPLE / np.maximum(scene.speed[joints], 1e-3)
    high = np.clip(high, low, 200.0)
    cycles = np.round(low * (high / low) ** rng.uniform(0, 1, len(joints)))
    phases = rng.uniform(0, 2 * np.pi, (2, len(joints)))
    return {"cycles": cycles, "phase": phases[0], "second": phases[1]}


def _ripple(put: Put) -> Changed:
    """A (sin(n q + phi) + sin(2 n q + phi') / 4)."""
    angle = put["cycles"] * put.scene.recording.q[:, put.joints]
    wave = np.sin(angle + put["phase"])
    wave = wave + SECOND_HARMONIC * np.sin(2 * angle + put["second"])
    truth = {"amplitude": put.x, "cycles": put["cycles"], "phase": put["phase"]}
    return put.added(-put.x * wave), truth


# Laws that act through the positions

HARDENING = 0.25
"""Share by which a spring of a gear is stiffer at the largest torque [1]."""
DAMPING = 0.1
"""Damping ratio of a joint's inertia on its spring [1]."""
SOFT_FLANK = 0.04
"""Torque over the largest at which free play is closed to three quarters [1]."""
DITHER = 0.15
"""Noise before rounding, over the step [1]."""


def motor_moved(put: Put, twist: np.ndarray) -> Recording:
    """A recording whose encoders sit on motors that lead the joints by a twist [rad], (N, k).

    The joints move as they did; the motors' rotors and friction need another torque.
    """
    scene, recording = put.scene, put.recording
    leading = np.zeros_like(scene.dq)
    leading[:, put.joints] = twist
    rate, bend = scene.rates(leading)
    friction = scene.truth.friction
    extra = scene.truth.armature * bend + friction(scene.dq + rate) - friction(scene.dq)
    dq = None if recording.dq is None else recording.dq + rate
    tau = recording.tau + extra
    return replace(recording, q=recording.q + leading, dq=dq, tau=tau)


def _draw_load(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """Largest torque through the transmission [N m]; nothing at random."""
    return {"largest": np.abs(scene.load[:, joints]).max(axis=0)}


def _elasticity(put: Put) -> Changed:
    """A spring that hardens by a quarter; x is the compliance [rad/kN m], the stiffness that of least squares."""
    scene, torque = put.scene, put.scene.load[:, put.joints]
    spring = 1e-3 * put.x * torque / (1 + HARDENING * (torque / put["largest"]) ** 2)
    compliance = amount(torque, spring)
    inertia = np.diag(scene.true_body.mass_matrix(scene.motion.q[0]))[put.joints]
    damping = 2 * DAMPING * np.sqrt(inertia / compliance)
    # with the damper beside it the spring follows its torque late, by so little that the first order does
    rate, _ = scene.rates(spring)
    truth = {"stiffness": 1 / compliance, "damping": damping}
    return motor_moved(put, spring - damping * compliance * rate), truth


def _backlash(put: Put) -> Changed:
    """Free play that closes smoothly, w / 2 tanh(tau / T)."""
    torque = put.scene.load[:, put.joints]
    twist = 0.5 * put.x * np.tanh(torque / (SOFT_FLANK * put["largest"]))
    return motor_moved(put, twist), {"width": put.x}


def _quantization(put: Put) -> Changed:
    """Positions rounded to steps, with dither."""
    q = put.recording.q
    steps = q[:, put.joints] / put.x + put["noise"][: len(q), put.joints]
    return put.changed("q", np.round(steps) * put.x), {"step": put.x}


STEPS = {2.5: 5e-4, 4.0: 1e-3, 8.0: 2e-3}
"""Quantisation step of an encoder by size [rad]."""


def sign_flip(put: Put) -> Changed:
    """The torque of a joint turned round."""
    return put.changed("tau", -put.tau), {}


def joint_swap(put: Put) -> Changed:
    """The torques of two joints exchanged."""
    return put.changed("tau", put.tau[:, ::-1]), {}


def _draw_unit(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """The kind of unit, and a gear ratio [1]."""
    return {"unit": str(rng.choice(UNITS)), "ratio": float(rng.integers(50, 161))}


def unit_mismatch(put: Put) -> Changed:
    """Degrees, milliseconds, or the motors' side of the gears."""
    columns = {
        name: series
        for name in ("t", "q", "dq", "tau")
        if (series := getattr(put.recording, name)) is not None
    }
    changed = in_other_units(columns, put["unit"], put["ratio"])
    return replace(put.recording, **changed), {"unit": put["unit"]}


MORE = (
    RecordedLaw(
        "stribeck_friction",
        "1 / (1 + (v / vs)^2)",
        1,
        lambda rng, scene, joints: {
            "velocity": np.clip(rng.uniform(0.1, 0.5) * scene.speed[joints], 0.02, 2.9)
        },
        _stribeck,
    ),
    RecordedLaw(
        "load_friction",
        "power 0.8 to 1.2 of the load",
        1,
        lambda rng, scene, joints: {
            "power": float(rng.choice([0.8, 0.9, 1.1, 1.2])),
            "speed": scene.speed[joints],
            "load": np.abs(scene.torque[:, joints]).mean(axis=0),
        },
        _load_friction,
        0.1,
    ),
    RecordedLaw(
        "friction_drift",
        "linear, or two exponentials",
        1,
        lambda rng, scene, joints: {
            "form": str(rng.choice(["linear", "two exponentials"])),
            "time": float(rng.uniform(0.2, 0.6)) * scene.recording.duration,
        },
        _drift,
        0.5,
    ),
    RecordedLaw(
        "link_inertia",
        "inertia by the power 5/3 of the mass",
        0,
        lambda rng, scene, joints: {
            # between the first and the last
            "link": int(rng.integers(1, scene.nominal.n_joints - 1)),
            "com": rng.uniform(-0.02, 0.02, 3),
        },
        _link_inertia,
        0.5,
        place="arm",
        signed=True,
        slides=False,
    ),
    RecordedLaw(
        "external_force",
        "rises and falls by cosines",
        0,
        _draw_force,
        _external_force,
        20.0,
        place="arm",
    ),
    RecordedLaw(
        "torque_ripple",
        "with a second harmonic",
        3,
        _draw_ripple,
        _ripple,
        0.5,
        slides=False,
    ),
    RecordedLaw(
        "joint_elasticity",
        "a hardening spring",
        2,
        _draw_load,
        _elasticity,
        0.1,
        motor=True,
    ),
    RecordedLaw(
        "backlash",
        "free play that closes smoothly",
        2,
        _draw_load,
        _backlash,
        0.005,
        motor=True,
    ),
    RecordedLaw(
        "encoder_quantization",
        "with dither",
        6,
        lambda rng, scene, joints: {
            "noise": rng.uniform(-DITHER, DITHER, scene.recording.q.shape)
        },
        _quantization,
        1e-3,
        place="none",
    ),
    RecordedLaw("sign_flip", "torque of a joint", 7, nothing, sign_flip, place="none"),
    RecordedLaw(
        "joint_swap",
        "torque of neighbours",
        7,
        nothing,
        joint_swap,
        place="none",
        slides=False,
    ),
    RecordedLaw(
        "unit_mismatch",
        "degrees, milliseconds, motor side",
        7,
        _draw_unit,
        unit_mismatch,
        place="none",
        slides=False,
    ),
)
"""Laws of the benchmark alone."""
ORDER = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "load_friction",
    "friction_drift",
    "payload",
    "link_inertia",
    "armature",
    "base_tilt",
    "parallel_spring",
    "external_force",
    "torque_offset",
    "torque_ripple",
    "torque_scale",
    "actuator_lag",
    "actuator_delay",
    "joint_elasticity",
    "backlash",
    "encoder_offset",
    "encoder_quantization",
    "sign_flip",
    "joint_swap",
    "unit_mismatch",
)
"""In which order cases draw them."""
ALL = RECORDED_LAWS | {law.name: law for law in MORE}
LAWS = {name: ALL[name] for name in ORDER}
"""All laws by the effect that they make, in that order."""
