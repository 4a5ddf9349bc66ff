"""Laws of the benchmark of real arms: what one sees of a recording, and what it changes.

Their forms are not the catalogue's. The true value of a parameter that only the catalogue's form has is the one with
which that form fits the injected torque best by least squares. Loads, friction and rotors add to the recorded torque.
On the path from torque to joint, applied = (1 + s) recorded + offset + ripple, with applied the torque that the carrier
recorded: what its body needed. The last laws act through the positions, or are faults of the set-up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from real_carriers import at_samples, filtered, smooth_motion
from scipy.optimize import curve_fit

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

Values = dict[str, Any]
"""Parameters of an effect by name, a number, one per joint or a vector."""


@dataclass(frozen=True)
class Scene:
    """One piece of a carrier, N samples of n joints, healthy.

    Attributes:
        recording: the piece.
        nominal: the arm that a diagnosis starts from: the identified one.
        truth: the arm identified on all recordings of the carrier: its friction, rotors and bodies.
        residual: RMS that a full model leaves on this arm [N m], (n,).
    """

    recording: Recording
    nominal: NominalArm
    truth: NominalArm
    residual: np.ndarray

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.nominal.n_joints

    @cached_property
    def motion(self) -> Motion:
        """The smoothed motion, on a uniform grid."""
        return smooth_motion(self.recording)

    @cached_property
    def dq(self) -> np.ndarray:
        """Velocity at the samples [rad/s], (N, n)."""
        return at_samples(self.motion.dq, self.motion, self.recording.t)

    @cached_property
    def ddq(self) -> np.ndarray:
        """Acceleration at the samples [rad/s^2], (N, n)."""
        return at_samples(self.motion.ddq, self.motion, self.recording.t)

    @cached_property
    def torque(self) -> np.ndarray:
        """Recorded torque below 12 Hz [N m], (N, n)."""
        return filtered(np.asarray(self.recording.tau), self.rate, TORQUE_CUTOFF)

    @cached_property
    def healthy_torque(self) -> np.ndarray:
        """Torque that the identified arm needs for the recorded positions [N m], (N, n)."""
        return self.predicted(self.recording)

    @cached_property
    def speed(self) -> np.ndarray:
        """RMS speed of each joint [rad/s], (n,)."""
        return np.sqrt((self.dq**2).mean(axis=0))

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.recording.t) - 1) / self.recording.duration

    @cached_property
    def nominal_body(self) -> RigidBody:
        """Bodies that a diagnosis starts from."""
        return RigidBody(self.nominal)

    @cached_property
    def inertia(self) -> np.ndarray:
        """Diagonal of the mass matrix at the first sample [kg m^2], (n,)."""
        return np.diag(self.true_body.mass_matrix(self.motion.q[0]))

    @cached_property
    def true_body(self) -> RigidBody:
        """Bodies of the identified arm."""
        return RigidBody(self.truth)

    def rigid(self, body: RigidBody) -> np.ndarray:
        """Inverse dynamics of some bodies on the smoothed motion, at the samples [N m], (N, n)."""
        m = self.motion
        torque = body.inverse_dynamics(m.q, m.dq, m.ddq)
        return at_samples(torque, m, self.recording.t)

    def predicted(self, recording: Recording) -> np.ndarray:
        """Torque that the identified arm needs for the positions of a recording, at its samples [N m], (N, n)."""
        motion = smooth_motion(recording)
        torque = CorrectedArm(self.truth).predict(self.true_body, motion)
        return at_samples(torque, motion, recording.t)

    def gap(self, changed: Recording) -> np.ndarray:
        """RMS by which the torque gap changes with a recording, as ``torque_nrmse`` sees it [N m], (n,).

        Below 12 Hz and without the ends: the change of the torque less that of the torque that the positions ask for.
        """
        count = len(changed.t)
        change = np.asarray(changed.tau) - np.asarray(self.recording.tau)[:count]
        if not np.array_equal(changed.q, self.recording.q[:count]):
            change = change - self.predicted(changed) + self.healthy_torque[:count]
        edge = int(np.ceil(TRIM * self.rate))
        kept = low_pass(change, self.rate, TORQUE_CUTOFF)[edge:-edge]
        return np.sqrt((kept**2).mean(axis=0))


@dataclass(frozen=True)
class Put:
    """An effect that is put into a recording.

    Attributes:
        scene: the healthy recording.
        recording: that with the effects so far.
        joints: from 0, (k,); empty for the arm.
        x: size, one per joint or one number for the arm.
        drawn: the values that do not set the size.
    """

    scene: Scene
    recording: Recording
    joints: np.ndarray
    x: np.ndarray
    drawn: Values

    @property
    def v(self) -> np.ndarray:
        """Velocity of the joints [rad/s], (N, k)."""
        return self.scene.dq[:, self.joints]

    def added(self, torque: np.ndarray, *, link_side: bool = False) -> Recording:
        """The recording with a torque of the joints added [N m], (N, k)."""
        full = np.zeros_like(self.scene.dq)
        full[:, self.joints] = torque
        return added(self.recording, full, link_side=link_side)

    def with_torque(self, torque: np.ndarray) -> Recording:
        """The recording with another torque of the joints [N m], (N, k)."""
        tau = np.array(self.recording.tau)
        tau[:, self.joints] = torque
        return replace(self.recording, tau=tau)


Draw = Callable[[Scene, np.random.Generator, np.ndarray], Values]


@dataclass(frozen=True)
class Law:
    """One law of the benchmark.

    Attributes:
        name: effect or fault that it makes.
        form: how its form differs from the catalogue's.
        stage: order in which laws act: 0 loads, 1 friction and rotors, 2 transmission, 3 to 5 the way from the recorded
            torque to the joint, 6 sensing, 7 faults of the set-up.
        draw: values at random that do not set its size.
        apply: recording with the effect and the values for the label.
        start: a size to begin with, in the unit of the parameter ``size``.
        size: parameter of the catalogue that is held against what is typical on real arms.
        place: ``joint`` (sized on that joint's torque), ``spread`` (on one joint, sized on the torque that it changes
            most), ``arm`` (the same, without a joint) or ``none`` (no size).
        signed: whether the size may be negative.
        motor: whether it needs encoders on the motors.
    """

    name: str
    form: str
    stage: int
    draw: Draw
    apply: Callable[[Put], tuple[Recording, Values]]
    start: float = 1.0
    size: str = ""
    place: str = "joint"
    signed: bool = False
    motor: bool = False


def added(
    recording: Recording, torque: np.ndarray, *, link_side: bool = False
) -> Recording:
    """A recording with a torque added [N m], (N, n); to the sensors behind the gear too if it acts on the links."""
    sensor = recording.tau_sensor
    if sensor is not None and link_side:
        sensor = sensor + torque
    tau = np.asarray(recording.tau) + torque
    return replace(recording, tau=tau, tau_sensor=sensor)


def amount(form: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Factor per column with which a form fits a series best, by least squares; both (N, k)."""
    return (form * series).sum(axis=0) / np.maximum((form**2).sum(axis=0), 1e-12)


def no_values(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Nothing is drawn."""
    return {}


# Loads, friction and rotors

SELF_LOCKED = 1e4
"""Torque at which a joint counts as locked by its own friction [N m]."""
LOAD_ROUNDS = 60
"""Times that friction and the torque which overcomes it are put into each other."""
BODY_SIZE = (0.03, 0.1)
"""Radius of gyration of an added body [m]."""


def sign(v: np.ndarray) -> np.ndarray:
    """The sign of a velocity as friction has it on average, tanh(v / 0.005 rad/s) [1]."""
    return np.tanh(v / 0.005)


def draw_coulomb(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """A step of a certain width, or one that differs between the directions by 15 %."""
    width = rng.uniform(0.01, 0.04) * scene.speed[joints]
    return {"width": width, "skew": float(rng.choice([0.0, 0.075, -0.075]))}


def coulomb(put: Put) -> tuple[Recording, Values]:
    """C (2 / pi) atan(v / w) (1 + skew sgn v)."""
    step = 2 / np.pi * np.arctan(put.v / put.drawn["width"])
    torque = put.x * step * (1 + put.drawn["skew"] * np.sign(put.v))
    # of the asymmetric one the mean over both directions
    return put.added(torque), {"torque": amount(sign(put.v), torque)}


def draw_viscous(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The power of the speed."""
    return {"power": float(rng.choice([0.8, 0.9, 1.1, 1.2]))}


def viscous(put: Put) -> tuple[Recording, Values]:
    """B v0 (abs v / v0)^p sgn v, with v0 the RMS speed."""
    v, mean = put.v, put.scene.speed[put.joints]
    torque = put.x * mean * (np.abs(v) / mean) ** put.drawn["power"] * np.sign(v)
    return put.added(torque), {"coefficient": amount(v, torque)}


def draw_stribeck(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The velocity at which half of it is gone."""
    velocity = rng.uniform(0.1, 0.5) * scene.speed[joints]
    return {"velocity": np.clip(velocity, 0.02, 2.9)}


def stribeck(put: Put) -> tuple[Recording, Values]:
    """D sgn v / (1 + (v / vs)^2); the catalogue has a Gaussian."""
    v, scale = put.v, put.drawn["velocity"]
    torque = put.x * sign(v) / (1 + (v / scale) ** 2)

    def gauss(speed: np.ndarray, d: float, vs: float) -> np.ndarray:
        return d * np.exp(-((speed / vs) ** 2)) * sign(speed)

    fits = []
    for k, start in enumerate(np.column_stack([put.x, scale])):
        fit, _ = curve_fit(gauss, v[:, k], torque[:, k], start, maxfev=2000)
        fits.append(fit)
    found, velocity = np.transpose(fits)
    return put.added(torque), {"torque": found, "velocity": np.abs(velocity)}


def load_friction(put: Put) -> tuple[Recording, Values]:
    """Mu T (abs tau / T)^p tanh(v / w), T the mean load; tau, the motor's torque, overcomes this friction too."""
    without, power = put.scene.torque[:, put.joints], put.drawn["power"]
    mean = np.abs(without).mean(axis=0)
    direction = np.tanh(put.v / (0.02 * put.scene.speed[put.joints]))
    motor = without
    for _ in range(LOAD_ROUNDS):
        law = put.x * mean * (np.abs(motor) / mean) ** power * direction
        # a joint that locks itself has no finite torque, and is no case
        motor = np.clip(without + law, -SELF_LOCKED, SELF_LOCKED)
    form = np.abs(motor) * sign(put.v)
    return put.added(law), {"coefficient": amount(form, law)}


def draw_drift(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Time of the warm-up as a share of the recording, and its form."""
    form = str(rng.choice(["linear", "two exponentials"]))
    return {"share": float(rng.uniform(0.2, 0.6)), "form": form}


def drift(put: Put) -> tuple[Recording, Values]:
    """Friction of the identified arm times a warm-up: linear to zero, or two exponentials."""
    t, arm = put.recording.t, put.scene.truth
    time = put.drawn["share"] * put.recording.duration
    fade = 0.7 * np.exp(-t / (0.6 * time)) + 0.3 * np.exp(-t / (2 * time))
    if put.drawn["form"] == "linear":
        fade = np.clip(1 - t / (2 * time), 0.0, 1.0)
    coulomb, viscous = arm.coulomb[put.joints], arm.viscous[put.joints]
    friction = coulomb * sign(put.v) + viscous * put.v

    def exponential(at: np.ndarray, a: float, constant: float) -> np.ndarray:
        return a * np.exp(-at / constant)

    (height, constant), _ = curve_fit(exponential, t, fade, (1.0, time), maxfev=2000)
    constants = np.full(len(put.joints), constant)
    truth = {"amplitude": put.x * height, "time_constant": constants}
    return put.added(friction * fade[:, None] * put.x), truth


def draw_payload(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Centre of mass [m] and radius of gyration about each axis [m]."""
    return {"com": rng.uniform(-0.1, 0.1, 3), "gyration": rng.uniform(*BODY_SIZE, 3)}


def payload(put: Put) -> tuple[Recording, Values]:
    """A body on the last link, with rotational inertia of its own."""
    mass, c, scene = np.ravel(put.x)[0], put.drawn["com"], put.scene
    own = np.diag(mass * put.drawn["gyration"] ** 2)
    increments = np.zeros((scene.n, 10))
    increments[scene.nominal_body.last_link] = ten_parameters(mass, c, own)
    return with_bodies(put, increments), {"mass": mass, "com": c}


def ten_parameters(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Inertial parameters in pinocchio's order, (10,), of a body with an inertia about its centre [kg m^2], (3, 3)."""
    about = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    moments = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([[mass], mass * com, moments])


def with_bodies(put: Put, increments: np.ndarray) -> Recording:
    """The recording of an arm whose bodies differ from the nominal ones; increments (n, 10)."""
    body = put.scene.nominal_body
    torque = put.scene.rigid(body.changed(increments)) - put.scene.rigid(body)
    return added(put.recording, torque, link_side=True)


def draw_link(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """A link between the first and the last, and the shift of its centre [m]."""
    link = int(rng.integers(1, scene.n - 1))
    return {"link": link, "com": rng.uniform(-0.02, 0.02, 3)}


def link_inertia(put: Put) -> tuple[Recording, Values]:
    """A link of another size at the same density: its inertia grows with the power 5/3 of its mass."""
    scene, place, com = put.scene, put.drawn["link"], put.drawn["com"]
    own = scene.nominal_body.model.inertias[int(scene.nominal_body.links[place])]
    mass = own.mass + np.ravel(put.x)[0]
    growth = (max(mass, 1e-3) / max(own.mass, 1e-3)) ** (5 / 3)
    new = ten_parameters(mass, own.lever + com, np.asarray(own.inertia) * growth)
    increments = np.zeros((scene.n, 10))
    increments[place] = new - own.toDynamicParameters()
    truth = {"link": place + 1, "mass": np.ravel(put.x)[0], "com": com}
    return with_bodies(put, increments), truth


def armature(put: Put) -> tuple[Recording, Values]:
    """I a, of the acceleration of the benchmark's own filter."""
    return put.added(put.scene.ddq[:, put.joints] * put.x), {"inertia": put.x}


LOAD_LAWS = (
    Law("coulomb_friction", "atan of a width, or 15 % between the directions", 1, draw_coulomb, coulomb, 1.0, "torque"),
    Law("viscous_friction", "power 0.8 to 1.2 of the speed", 1, draw_viscous, viscous, 1.0, "coefficient"),
    Law("stribeck_friction", "1 / (1 + (v / vs)^2)", 1, draw_stribeck, stribeck, 1.0, "torque"),
    Law("load_friction", "power 0.8 to 1.2 of the load", 1, draw_viscous, load_friction, 0.1, "coefficient"),
    Law("friction_drift", "linear, or two exponentials", 1, draw_drift, drift, 0.5, "amplitude"),
    Law("payload", "a body with its own rotational inertia", 0, draw_payload, payload, 1.0, "mass", "arm"),
    Law("link_inertia", "inertia by the power 5/3 of the mass", 0, draw_link, link_inertia, 0.5, "mass", "arm", True),
    Law("armature", "another filter of the acceleration", 1, no_values, armature, 0.3, "inertia"),
)  # fmt: skip


# The path from torque to joint; mounting, springs and forces

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


def base_tilt(put: Put) -> tuple[Recording, Values]:
    """Gravity turned, on the bodies that were identified on the whole carrier."""
    scene, direction = put.scene, put.drawn["direction"]
    angle = np.ravel(put.x)[0]
    roll, pitch = angle * np.cos(direction), angle * np.sin(direction)
    gravity = turned_gravity(scene.truth.gravity, roll, pitch)
    body = scene.true_body
    turned = body.changed(np.zeros((scene.n, 10)), gravity)
    torque = scene.rigid(turned) - scene.rigid(body)
    changed = added(put.recording, torque, link_side=True)
    return changed, {"roll": roll, "pitch": pitch}


def draw_rest(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Where the spring is slack [rad]."""
    q = scene.recording.q[:, joints]
    middle, half = (q.max(axis=0) + q.min(axis=0)) / 2, np.ptp(q, axis=0) / 2
    return {"rest": middle + rng.uniform(-0.7, 0.7, len(joints)) * half}


def spring(put: Put) -> tuple[Recording, Values]:
    """K (q - q0) (1 + 0.15 (q - q0)^2 / the largest), stiffness and rest by least squares."""
    q = put.scene.recording.q[:, put.joints]
    stretch = q - put.drawn["rest"]
    cubic = stretch**3 / (stretch**2).max(axis=0)
    torque = put.x * (stretch + 0.15 * cubic)
    lines = [np.polyfit(*pair, 1) for pair in zip(q.T, torque.T, strict=True)]
    slope, level = np.transpose(lines)
    truth = {"stiffness": slope, "rest": -level / slope}
    return put.added(torque, link_side=True), truth


def draw_force(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Direction, begin and end of a push [1], [s]."""
    direction = rng.standard_normal(3)
    duration = scene.recording.duration
    start = float(rng.uniform(0.15, 0.5) * duration)
    length = float(rng.uniform(0.2, 0.35) * duration)
    unit = direction / np.linalg.norm(direction)
    return {"direction": unit, "start": start, "end": start + length}


def external_force(put: Put) -> tuple[Recording, Values]:
    """A push that rises and falls by cosines over a fifth of its time; the force that fits best within its time."""
    t, start, end = put.recording.t, put.drawn["start"], put.drawn["end"]
    edge = 0.2 * (end - start)
    rise = np.clip((t - start) / edge, 0, 1) * np.clip((end - t) / edge, 0, 1)
    shape = 0.5 - 0.5 * np.cos(np.pi * rise)
    inside = (t >= start) & (t <= end)
    force = np.ravel(put.x)[0] * put.drawn["direction"]
    position = np.asarray(put.scene.recording.q)
    torque = put.scene.nominal_body.force_torque(position, force)
    power = (torque[inside] ** 2).sum(axis=1)
    share = float((shape[inside] * power).sum() / (torque[inside] ** 2).sum())
    truth = {"force": share * force, "start": start, "end": end}
    return added(put.recording, -shape[:, None] * torque, link_side=True), truth


def scale(put: Put) -> tuple[Recording, Values]:
    """applied = (1 + s (1 - 0.15 (u / largest)^2)) u, solved for the recorded u; s by least squares."""
    applied = np.asarray(put.recording.tau)[:, put.joints]
    largest = np.abs(applied).max(axis=0)
    u = applied / (1 + put.x)
    for _ in range(30):
        u = applied / (1 + put.x * (1 - CURVATURE * (u / largest) ** 2))
    return put.with_torque(u), {"scale": amount(u, applied) - 1}


def offset(put: Put) -> tuple[Recording, Values]:
    """An offset that drifts by 8 % over the recording; its mean."""
    t = put.recording.t / put.recording.duration
    drift = 1 + OFFSET_DRIFT * (t - 0.5)
    return put.added(-put.x * drift[:, None]), {"torque": put.x}


def draw_ripple(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Whole periods per revolution that the motion shows and 12 Hz let through, and phases [rad]."""
    swing = np.ptp(scene.recording.q[:, joints], axis=0)
    low = np.maximum(2 * np.pi * SLOWEST_PERIODS / swing, 2.0)
    high = 2 * np.pi * FASTEST_RIPPLE / np.maximum(scene.speed[joints], 1e-3)
    high = np.clip(high, low, 200.0)
    cycles = np.round(low * (high / low) ** rng.uniform(0, 1, len(joints)))
    phases = rng.uniform(0, 2 * np.pi, (2, len(joints)))
    return {"cycles": cycles, "phase": phases[0], "second": phases[1]}


def ripple(put: Put) -> tuple[Recording, Values]:
    """A (sin(n q + phi) + sin(2 n q + phi') / 4)."""
    drawn = put.drawn
    angle = drawn["cycles"] * put.scene.recording.q[:, put.joints]
    wave = np.sin(angle + drawn["phase"])
    wave = wave + SECOND_HARMONIC * np.sin(2 * angle + drawn["second"])
    truth = {"amplitude": put.x, "cycles": drawn["cycles"], "phase": drawn["phase"]}
    return put.added(-put.x * wave), truth


def delay(put: Put) -> tuple[Recording, Values]:
    """recorded(t) = applied(t + T), by linear interpolation; the last samples have no torque and are left out."""
    t, tau = put.recording.t, np.array(put.recording.tau)
    for joint, time in zip(put.joints, put.x, strict=True):
        tau[:, joint] = np.interp(t + time, t, tau[:, joint])
    count = int((t <= t[-1] - put.x.max()).sum())
    changed = replace(put.recording, tau=tau)
    return changed.part(slice(None, count)), {"delay": put.x}


def draw_lag(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Share of the second time constant [1]."""
    return {"second": float(rng.uniform(0.0, 0.3))}


def lag(put: Put) -> tuple[Recording, Values]:
    """Two lags one after the other, inverted below 15 Hz; the sum of their time constants.

    Of the torque that the identified arm predicts: the noise of what was recorded did not pass the lags.
    """
    scene, joints = put.scene, put.joints
    first, second = put.x * (1 - put.drawn["second"]), put.x * put.drawn["second"]
    torque = filtered(scene.healthy_torque, scene.rate, LAG_BAND)
    rate = np.gradient(torque, put.recording.t, axis=0, edge_order=2)
    bend = np.gradient(rate, put.recording.t, axis=0, edge_order=2)
    extra = put.x * rate[:, joints] + first * second * bend[:, joints]
    return put.added(extra), {"time_constant": put.x}


PATH_LAWS = (
    Law("base_tilt", "gravity turned on identified bodies", 0, draw_direction, base_tilt, 0.05, "", "arm"),
    Law("parallel_spring", "slightly cubic", 0, draw_rest, spring, 5.0, "stiffness"),
    Law("external_force", "rises and falls by cosines", 0, draw_force, external_force, 20.0, "force", "arm"),
    Law("torque_offset", "drifts by 8 %", 3, no_values, offset, 1.0, "torque", signed=True),
    Law("torque_ripple", "with a second harmonic", 3, draw_ripple, ripple, 0.5, "amplitude"),
    Law("torque_scale", "less by 15 % at the largest torque", 4, no_values, scale, 0.1, "scale", signed=True),
    Law("actuator_lag", "two lags in a row", 5, draw_lag, lag, 0.01, "time_constant"),
    Law("actuator_delay", "linear interpolation", 5, no_values, delay, 0.01, "delay"),
)  # fmt: skip


# Laws that act through the positions, and faults of the set-up

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


def motor_moved(put: Put, twist: np.ndarray) -> Recording:
    """A recording whose encoders sit on motors that lead the joints by a twist [rad], (N, k).

    The joints move as the carrier's; the motors' rotors and friction need another torque.
    """
    scene, recording = put.scene, put.recording
    leading = np.zeros_like(scene.dq)
    leading[:, put.joints] = twist
    rate = np.gradient(leading, recording.t, axis=0, edge_order=2)
    bend = np.gradient(rate, recording.t, axis=0, edge_order=2)
    extra = scene.truth.armature * bend
    extra = extra + friction(scene, scene.dq + rate) - friction(scene, scene.dq)
    dq = None if recording.dq is None else recording.dq + rate
    tau = np.asarray(recording.tau) + extra
    return replace(recording, q=recording.q + leading, dq=dq, tau=tau)


def elasticity(put: Put) -> tuple[Recording, Values]:
    """A spring that hardens by a quarter; x is the compliance [rad/kN m], the stiffness that of least squares."""
    torque = load(put.scene)[:, put.joints]
    largest = np.abs(torque).max(axis=0)
    spring = 1e-3 * put.x * torque / (1 + HARDENING * (torque / largest) ** 2)
    compliance = (spring * torque).sum(axis=0) / (torque**2).sum(axis=0)
    inertia = put.scene.inertia[put.joints]
    damping = 2 * DAMPING * np.sqrt(inertia / compliance)
    # with the damper beside it the spring follows its torque late, by so little that the first order does
    rate = np.gradient(spring, put.recording.t, axis=0, edge_order=2)
    truth = {"stiffness": 1 / compliance, "damping": damping}
    return motor_moved(put, spring - damping * compliance * rate), truth


def backlash(put: Put) -> tuple[Recording, Values]:
    """Free play that closes smoothly, w / 2 tanh(tau / T)."""
    torque = load(put.scene)[:, put.joints]
    soft = SOFT_FLANK * np.abs(torque).max(axis=0)
    twist = 0.5 * put.x * np.tanh(torque / soft)
    return motor_moved(put, twist), {"width": put.x}


def encoder_offset(put: Put) -> tuple[Recording, Values]:
    """Positions shifted."""
    q = np.array(put.recording.q)
    q[:, put.joints] += put.x
    return replace(put.recording, q=q), {"offset": put.x}


def draw_dither(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Noise before rounding [1], (N, n)."""
    return {"noise": rng.uniform(-DITHER, DITHER, scene.recording.q.shape)}


def quantization(put: Put) -> tuple[Recording, Values]:
    """Positions rounded to steps, with dither."""
    q = np.array(put.recording.q)
    noise = put.drawn["noise"][: len(q), put.joints]
    q[:, put.joints] = np.round(q[:, put.joints] / put.x + noise) * put.x
    return replace(put.recording, q=q), {"step": put.x}


def sign_flip(put: Put) -> tuple[Recording, Values]:
    """The torque of a joint turned round."""
    return put.with_torque(-np.asarray(put.recording.tau)[:, put.joints]), {}


def joint_swap(put: Put) -> tuple[Recording, Values]:
    """The torques of two joints exchanged."""
    return put.with_torque(np.asarray(put.recording.tau)[:, put.joints[::-1]]), {}


def draw_unit(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The kind of unit, and a gear ratio [1]."""
    return {"unit": str(rng.choice(UNITS)), "ratio": float(rng.integers(50, 161))}


def unit_mismatch(put: Put) -> tuple[Recording, Values]:
    """Degrees, milliseconds, or the motors' side of the gears."""
    recording, truth = put.recording, {"unit": put.drawn["unit"]}
    if put.drawn["unit"] == "milliseconds":
        return replace(recording, t=1e3 * recording.t), truth
    degrees = put.drawn["unit"] == "degrees"
    factor = 180 / np.pi if degrees else put.drawn["ratio"]
    dq = None if recording.dq is None else factor * recording.dq
    tau = np.asarray(recording.tau) / (1.0 if degrees else put.drawn["ratio"])
    return replace(recording, q=factor * recording.q, dq=dq, tau=tau), truth


POSITION_LAWS = (
    Law("joint_elasticity", "a hardening spring", 2, no_values, elasticity, 0.1, "stiffness", motor=True),
    Law("backlash", "free play that closes smoothly", 2, no_values, backlash, 0.005, "width", motor=True),
    Law("encoder_offset", "the same", 6, no_values, encoder_offset, 0.03, "offset", "spread", True),
    Law("encoder_quantization", "with dither", 6, draw_dither, quantization, 1e-3, "step", "none"),
    Law("sign_flip", "torque of a joint", 7, no_values, sign_flip, place="none"),
    Law("joint_swap", "torque of neighbours", 7, no_values, joint_swap, place="none"),
    Law("unit_mismatch", "degrees, milliseconds, motor side", 7, draw_unit, unit_mismatch, place="none"),
)  # fmt: skip

LAWS = {law.name: law for law in (*LOAD_LAWS, *PATH_LAWS, *POSITION_LAWS)}
"""All laws by the effect that they make."""
