"""What a law of the benchmark of real arms sees of a recording, and what it changes; see ``real_injections.py``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from real_motion import at_samples, filtered, smooth_motion

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


Draw = Callable[[Scene, np.random.Generator, np.ndarray], Values]
Apply = Callable[
    [Scene, Recording, np.ndarray, np.ndarray, Values], tuple[Recording, Values]
]


@dataclass(frozen=True)
class Law:
    """One law of the benchmark.

    Attributes:
        name: effect or fault that it makes.
        form: how its form differs from the catalogue's.
        stage: order in which laws act: 0 loads, 1 friction and rotors, 2 transmission, 3 to 5 the way from the recorded
            torque to the joint, 6 sensing, 7 faults of the set-up.
        draw: values at random that do not set its size.
        apply: recording with the effect and the values for the label; gets the scene, the recording so far, the joints
            from 0, the size (one per joint, or one number for the arm) and what was drawn.
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
    apply: Apply
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


def shortened(recording: Recording, count: int) -> Recording:
    """The first samples of a recording."""
    names = ("q", "dq", "tau", "tau_sensor", "temperature")
    channels = {name: getattr(recording, name) for name in names}
    kept = {k: None if x is None else x[:count] for k, x in channels.items()}
    return replace(recording, t=recording.t[:count], **kept)


def on_joints(series: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """A series (N, n) with zeros on all other joints."""
    out = np.zeros_like(series)
    out[:, joints] = series[:, joints]
    return out


def amount(form: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Factor per column with which a form fits a series best, by least squares; both (N, k)."""
    return (form * series).sum(axis=0) / np.maximum((form**2).sum(axis=0), 1e-12)


def no_values(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Nothing is drawn."""
    return {}
