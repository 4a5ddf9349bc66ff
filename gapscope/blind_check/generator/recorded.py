"""Laws that put an effect of known size into a recording: what one sees of the motion, and what it changes.

Their forms are not the catalogue's. The true value of a parameter that only the catalogue's form has is the one with
which that form fits the injected torque best by least squares. Loads, friction and rotors add to the recorded torque.
On the path from torque to joint, applied = (1 + s) recorded + offset + ripple, with applied the torque that was
recorded: what the body needed. Others act through the positions. The motion comes from filters of its own, not from
the conditioning of the diagnosis. Saturation is left out: what a recording would have been with less torque than it
shows is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import UPPER, point_mass_parameters
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms

Values = Mapping[str, Any]
"""Parameters of an effect by name, a number, one per joint or a vector."""
BAND = 15.0
"""Positions, and derivatives of the torque, are followed up to this frequency [Hz], or 0.35 of the sampling rate."""


def filtered(series: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass of order 2, forward and backward, along axis 0."""
    sos = butter(2, min(cutoff, 0.35 * rate), output="sos", fs=rate)
    padding = min(len(series) - 1, int(3 * rate / cutoff))
    return sosfiltfilt(sos, series, axis=0, padlen=padding)


def smooth_motion(recording: Recording) -> Motion:
    """Filtered positions with central differences, on as many uniform times as the recording has."""
    grid = np.linspace(recording.t[0], recording.t[-1], len(recording.t))
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    q = filtered(PchipInterpolator(recording.t, recording.q)(grid), rate, BAND)
    dq = np.gradient(q, grid, axis=0, edge_order=2)
    ddq = filtered(np.gradient(dq, grid, axis=0, edge_order=2), rate, BAND)
    return Motion(grid, q, dq, ddq)


def at_samples(series: np.ndarray, motion: Motion, t: np.ndarray) -> np.ndarray:
    """A series on a motion's grid, (N, n), at times t [s], (M, n)."""
    inside = np.clip(t, *motion.t[[0, -1]])
    return PchipInterpolator(motion.t, series)(inside)


@dataclass(frozen=True)
class Scene:
    """A recording with a torque, N samples of n joints, before anything is put into it.

    Attributes:
        recording: the recording.
        nominal: the arm that a diagnosis starts from.
        truth: the arm as it is known best: its friction, rotors and bodies.
    """

    recording: Recording
    nominal: NominalArm
    truth: NominalArm

    @cached_property
    def motion(self) -> Motion:
        """The smoothed motion, on a uniform grid."""
        return smooth_motion(self.recording)

    @cached_property
    def dq(self) -> np.ndarray:
        """Velocity at the samples [rad/s], (N, n)."""
        return at_samples(self.motion.dq, self.motion, self.recording.t)

    @cached_property
    def speed(self) -> np.ndarray:
        """RMS speed of each joint [rad/s], (n,)."""
        return rms(self.dq)

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.recording.t) - 1) / self.recording.duration

    @cached_property
    def nominal_body(self) -> RigidBody:
        """Bodies that a diagnosis starts from, with the known load of the recording."""
        return RigidBody(self.nominal).carrying(self.recording.payload)

    @cached_property
    def true_body(self) -> RigidBody:
        """Bodies as they are known best, with the known load of the recording."""
        return RigidBody(self.truth).carrying(self.recording.payload)

    def rigid(self, body: RigidBody) -> np.ndarray:
        """Inverse dynamics of some bodies on the smoothed motion, at the samples [N m], (N, n)."""
        m = self.motion
        torque = body.inverse_dynamics(m.q, m.dq, m.ddq)
        return at_samples(torque, m, self.recording.t)

    def needed(self, recording: Recording) -> np.ndarray:
        """Torque that the true arm needs for the positions of a recording, at its samples [N m], (N, n)."""
        m, arm = smooth_motion(recording), self.truth
        torque = self.true_body.inverse_dynamics(m.q, m.dq, m.ddq)
        torque = torque + arm.armature * m.ddq + arm.friction(m.dq)
        return at_samples(torque, m, recording.t)

    def rates(self, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivative of a series by time, (N, m)."""
        rate = np.gradient(series, self.recording.t, axis=0, edge_order=2)
        return rate, np.gradient(rate, self.recording.t, axis=0, edge_order=2)


@dataclass(frozen=True)
class Put:
    """An effect that is put into a recording.

    Attributes:
        scene: the recording as it was.
        recording: that with the effects so far.
        joints: from 0, (k,); empty for the arm.
        x: size, one per joint or one number for the arm.
        drawn: the values that do not set the size; ``put[name]`` is one of them.
    """

    scene: Scene
    recording: Recording
    joints: np.ndarray
    x: np.ndarray
    drawn: Values

    def __getitem__(self, name: str) -> Any:
        return self.drawn[name]

    @property
    def v(self) -> np.ndarray:
        """Velocity of the joints [rad/s], (N, k)."""
        return self.scene.dq[:, self.joints]

    @property
    def tau(self) -> np.ndarray:
        """Recorded torque of the joints with the effects so far [N m], (N, k)."""
        return np.asarray(self.recording.tau)[:, self.joints]

    def added(self, torque: np.ndarray, *, link_side: bool = False) -> Recording:
        """The recording with a torque added [N m], of the joints, (N, k), or of all, (N, n).

        To the sensors behind the gear too if it acts on the links.
        """
        full = np.zeros_like(self.scene.dq)
        full[:, self.joints if len(self.joints) else slice(None)] = torque
        tau, sensor = self.recording.tau, self.recording.tau_sensor
        if sensor is not None and link_side:
            sensor = sensor + full
        return replace(self.recording, tau=tau + full, tau_sensor=sensor)

    def changed(self, channel: str, series: np.ndarray) -> Recording:
        """The recording with another series of the joints in a channel, (N, k)."""
        whole = np.array(getattr(self.recording, channel))
        whole[:, self.joints] = series
        return replace(self.recording, **{channel: whole})  # type: ignore[arg-type]


Changed = tuple[Recording, Values]
"""A recording with an effect, and the effect's true values."""
Draw = Callable[[np.random.Generator, Scene, np.ndarray], Values]


class RecordedLaw(NamedTuple):
    """One law.

    Attributes:
        name: effect that it makes.
        form: how its form differs from the catalogue's.
        stage: order in which laws act: 0 loads, 1 friction and rotors, 2 transmission, 3 to 5 the way from the recorded
            torque to the joint, 6 sensing.
        draw: values, some of them at random, that do not set its size.
        apply: recording with the effect, and its true values.
        start: a size to begin with, in the unit of the parameter that is its size.
        place: ``joint`` (sized on that joint's torque), ``spread`` (on one joint, sized on the torque that it changes
            most), ``arm`` (the same, without a joint) or ``none`` (no torque by which it is sized).
        signed: whether the size may be negative.
        motor: whether it needs encoders on the motors.
        slides: whether it means something of its own on an arm that is a single slide: there a tilted base is an
            offset, the zero shows in nothing, mass has one name, and neither angle nor revolution means anything.
    """

    name: str
    form: str
    stage: int
    draw: Draw
    apply: Callable[[Put], Changed]
    start: float = 1.0
    place: str = "joint"
    signed: bool = False
    motor: bool = False
    slides: bool = True


def amount(form: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Factor per column with which a form fits a series best, by least squares; both (N, k)."""
    return (form * series).sum(axis=0) / np.maximum((form**2).sum(axis=0), 1e-12)


# Loads, friction and rotors


def nothing(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """Nothing is drawn."""
    return {}


def _coulomb(put: Put) -> Changed:
    """C (2 / pi) atan(v / w) (1 + skew sgn v)."""
    step = 2 / np.pi * np.arctan(put.v / put["width"])
    torque = put.x * step * (1 + put["skew"] * np.sign(put.v))
    # of the asymmetric one the mean over both directions
    return put.added(torque), {"torque": amount(smooth_sign(put.v), torque)}


def _viscous(put: Put) -> Changed:
    """B v0 (abs v / v0)^p sgn v, with v0 the RMS speed."""
    v, mean = put.v, put["speed"]
    torque = put.x * mean * (np.abs(v) / mean) ** put["power"] * np.sign(v)
    return put.added(torque), {"coefficient": amount(v, torque)}


def with_body(put: Put, link: int, increment: np.ndarray) -> Recording:
    """The recording of an arm one of whose bodies, numbered from 0, has other inertial parameters, (10,)."""
    body = put.scene.nominal_body
    increments = np.zeros((put.scene.nominal.n_joints, 10))
    increments[link] = increment
    torque = put.scene.rigid(body.changed(increments)) - put.scene.rigid(body)
    return put.added(torque, link_side=True)


def body_parameters(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Inertial parameters, (10,), of a body with an inertia about its centre [kg m^2], (3, 3)."""
    parameters = point_mass_parameters(mass, com)
    parameters[4:] += inertia[UPPER]
    return parameters


def _payload(put: Put) -> Changed:
    """A body on the last link, with rotational inertia of its own."""
    mass, com = np.ravel(put.x)[0], put["com"]
    body = body_parameters(mass, com, np.diag(mass * put["gyration"] ** 2))
    last = put.scene.nominal_body.last_link
    return with_body(put, last, body), {"mass": mass, "com": com}


def _armature(put: Put) -> Changed:
    """I a, of the acceleration of a filter of its own."""
    m = put.scene.motion
    ddq = at_samples(m.ddq, m, put.scene.recording.t)
    return put.added(ddq[:, put.joints] * put.x), {"inertia": put.x}


# The path from torque to joint; mounting, springs and forces

CURVATURE = 0.15
"""How much of a torque constant's error is lost at the largest torque [1]."""
OFFSET_DRIFT = 0.08
"""How much an offset changes over a recording [1]."""


def _base_tilt(put: Put) -> Changed:
    """Gravity turned, R^T g with R = Ry(pitch) Rx(roll), on the true bodies."""
    body, angle = put.scene.true_body, np.ravel(put.x)[0]
    roll, pitch = angle * np.cos(put["direction"]), angle * np.sin(put["direction"])
    turn = Rotation.from_euler("xy", [roll, pitch])
    unchanged = np.zeros((put.scene.nominal.n_joints, 10))
    turned = body.changed(unchanged, turn.inv().apply(put.scene.truth.gravity))
    torque = put.scene.rigid(turned) - put.scene.rigid(body)
    return put.added(torque, link_side=True), {"roll": roll, "pitch": pitch}


def _draw_rest(rng: np.random.Generator, scene: Scene, joints: np.ndarray) -> Values:
    """Where the spring is slack [rad], and how far it is stretched at most."""
    q = scene.recording.q[:, joints]
    middle, half = (q.max(axis=0) + q.min(axis=0)) / 2, np.ptp(q, axis=0) / 2
    rest = middle + rng.uniform(-0.7, 0.7, len(joints)) * half
    return {"rest": rest, "largest": ((q - rest) ** 2).max(axis=0)}


def _spring(put: Put) -> Changed:
    """K (q - q0) (1 + 0.15 (q - q0)^2 / the largest), stiffness and rest by least squares."""
    q = put.scene.recording.q[:, put.joints]
    stretch = q - put["rest"]
    torque = put.x * (stretch + 0.15 * stretch**3 / put["largest"])
    lines = [np.polyfit(*pair, 1) for pair in zip(q.T, torque.T, strict=True)]
    slope, level = np.transpose(lines)
    truth = {"stiffness": slope, "rest": -level / slope}
    return put.added(torque, link_side=True), truth


def _scale(put: Put) -> Changed:
    """applied = (1 + s (1 - 0.15 (u / largest)^2)) u, solved for the recorded u; s by least squares."""
    applied = put.tau
    largest = np.abs(applied).max(axis=0)
    u = applied / (1 + put.x)
    for _ in range(30):
        u = applied / (1 + put.x * (1 - CURVATURE * (u / largest) ** 2))
    return put.changed("tau", u), {"scale": amount(u, applied) - 1}


def _offset(put: Put) -> Changed:
    """An offset that drifts by 8 % over the recording; its mean."""
    t = put.recording.t / put.recording.duration
    drift = 1 + OFFSET_DRIFT * (t - 0.5)
    return put.added(-put.x * drift[:, None]), {"torque": put.x}


def _delay(put: Put) -> Changed:
    """recorded(t) = applied(t + T), by linear interpolation; the last samples have no torque and are left out."""
    t = put.recording.t
    each = zip(put.tau.T, put.x, strict=True)
    tau = np.transpose([np.interp(t + time, t, series) for series, time in each])
    count = int((t <= t[-1] - put.x.max()).sum())
    return put.changed("tau", tau).part(slice(None, count)), {"delay": put.x}


def _lag(put: Put) -> Changed:
    """Two lags one after the other, inverted below 15 Hz; the sum of their time constants.

    Of the torque that the true arm needs: the noise of what was recorded did not pass the lags.
    """
    scene, second = put.scene, put.x * put["second"]
    torque = filtered(scene.needed(scene.recording), scene.rate, BAND)
    rate, bend = scene.rates(torque[:, put.joints])
    extra = put.x * rate + (put.x - second) * second * bend
    return put.added(extra), {"time_constant": put.x}


def _encoder_offset(put: Put) -> Changed:
    """Positions shifted."""
    q = put.recording.q[:, put.joints] + put.x
    return put.changed("q", q), {"offset": put.x}


LAWS = (
    RecordedLaw(
        "coulomb_friction",
        "atan of a width, or 15 % between the directions",
        1,
        lambda rng, scene, joints: {
            "width": rng.uniform(0.01, 0.04) * scene.speed[joints],
            "skew": float(rng.choice([0.0, 0.075, -0.075])),
        },
        _coulomb,
    ),
    RecordedLaw(
        "viscous_friction",
        "power 0.8 to 1.2 of the speed",
        1,
        lambda rng, scene, joints: {
            "power": float(rng.choice([0.8, 0.9, 1.1, 1.2])),
            "speed": scene.speed[joints],
        },
        _viscous,
    ),
    RecordedLaw(
        "payload",
        "a body with its own rotational inertia",
        0,
        lambda rng, scene, joints: {
            "com": rng.uniform(-0.1, 0.1, 3),
            "gyration": rng.uniform(0.03, 0.1, 3),
        },
        _payload,
        place="arm",
    ),
    RecordedLaw(
        "armature",
        "another filter of the acceleration",
        1,
        nothing,
        _armature,
        0.3,
        slides=False,
    ),
    RecordedLaw(
        "base_tilt",
        "gravity turned on identified bodies",
        0,
        lambda rng, scene, joints: {"direction": float(rng.uniform(-np.pi, np.pi))},
        _base_tilt,
        0.05,
        place="arm",
        slides=False,
    ),
    RecordedLaw("parallel_spring", "slightly cubic", 0, _draw_rest, _spring, 5.0),
    RecordedLaw(
        "torque_offset",
        "drifts by 8 %",
        3,
        nothing,
        _offset,
        signed=True,
    ),
    RecordedLaw(
        "torque_scale",
        "less by 15 % at the largest torque",
        4,
        nothing,
        _scale,
        0.1,
        signed=True,
    ),
    RecordedLaw(
        "actuator_lag",
        "two lags in a row",
        5,
        lambda rng, scene, joints: {"second": float(rng.uniform(0.0, 0.3))},
        _lag,
        0.01,
    ),
    RecordedLaw(
        "actuator_delay",
        "linear interpolation",
        5,
        nothing,
        _delay,
        0.01,
    ),
    RecordedLaw(
        "encoder_offset",
        "the same",
        6,
        nothing,
        _encoder_offset,
        0.03,
        place="spread",
        signed=True,
        slides=False,
    ),
)
RECORDED_LAWS = {law.name: law for law in LAWS}
"""The laws by the effect that they make."""
