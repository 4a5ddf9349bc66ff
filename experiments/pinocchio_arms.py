"""Arms that pinocchio alone moves: bodies off the model's, friction of other forms than any law of the package."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm

DATA = Path(os.environ.get("GAPSCOPE_DATA", ""))
FORM_ARMS: dict[str, str | Path] = {
    "kuka_iiwa": "kuka_iiwa",
    "franka_panda": "franka_panda",
    "xarm6": "xarm6",
    "ur10": DATA / "ur10/ur10.urdf",
    "kinova_gen3": DATA / "kinova_gen3/gen3.urdf",
    "kuka_med7": DATA / "kuka_med7/med7dock.urdf",
}
Form = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
FORMS: dict[str, Form] = {
    "sharp Coulomb": lambda v, q, c, b: c * np.sign(v) + b * v,
    "Stribeck": lambda v, q, c, b: (
        c * (1 + 0.5 * np.exp(-((v / 0.08) ** 2))) * np.sign(v) + b * v
    ),
    "arctan": lambda v, q, c, b: 2 / np.pi * c * np.arctan(v / 0.1) + b * v,
    "square root": lambda v, q, c, b: (c + b * np.sqrt(np.abs(v))) * np.sign(v),
    "over position": lambda v, q, c, b: (
        c * (1 + 0.3 * np.sin(2 * q)) * np.sign(v) + b * v
    ),
    "quadratic": lambda v, q, c, b: c * np.sign(v) + b * v * (1 + 0.5 * np.abs(v)),
}
"""Friction of a joint by speed, position, Coulomb c and viscous b."""
RATE, FASTEST, LONG = 250.0, 1.0, 10.0
"""Of recordings [Hz], speed of the joints [rad/s], and length of a motion [s]."""
ENCODER = 1e-3
"""Noise of encoders over that of the torque, which is given as a share of its deviation [rad]."""


def noised(recording: Recording, level: float, rng: np.random.Generator) -> Recording:
    """A recording with the noise of one run."""
    assert recording.tau is not None
    q = recording.q + ENCODER * level * rng.standard_normal(recording.q.shape)
    spread = level * recording.tau.std(axis=0)
    return replace(
        recording,
        q=q,
        tau=recording.tau + spread * rng.standard_normal(recording.tau.shape),
        dq=None,
    )


@dataclass(frozen=True)
class FormArm:
    """An arm of n joints: its model, bodies, rotors, Coulomb and viscous friction."""

    model: NominalArm
    bodies: np.ndarray
    rotors: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray

    @classmethod
    def drawn(cls, robot: str | Path, rng: np.random.Generator) -> FormArm:
        """Bodies 20 % off the nominal ones, friction 30 % of the weight that a joint carries, within a third."""
        model = load_nominal_arm(robot)
        body, n = RigidBody(model), model.n_joints
        factor = rng.uniform(0.8, 1.25, (n, 1))
        bodies = (body.inertial_parameters().reshape(n, 10) * factor).ravel()
        q = workspace(body).posture + rng.uniform(-1, 1, (50, n))
        weight = np.abs(body.regressor(q, 0 * q, 0 * q) @ bodies).max(axis=0)
        weight = np.maximum(weight, 0.1 * weight.max())
        parts = weight * rng.uniform(0.7, 1.3, (3, n))
        return cls(
            model, bodies, 0.02 + 0.02 * parts[0], 0.3 * parts[1], 0.3 * parts[2]
        )

    def motions(
        self, rng: np.random.Generator, count: int, reach: float = np.inf
    ) -> list[tuple[np.ndarray, ...]]:
        """Time, position, velocity, acceleration of random Fourier motions within ``reach`` of their middle [rad]."""
        body = RigidBody(self.model)
        limits = urdf_limits(body, 6.0)
        centre, t = workspace(body).posture, np.arange(0, LONG, 1 / RATE)
        limits = limits._replace(
            velocity=np.minimum(limits.velocity, FASTEST),
            lower=np.maximum(limits.lower, centre - reach),
            upper=np.minimum(limits.upper, centre + reach),
        )
        out = []
        for _ in range(count):
            motion = Fourier.random(
                rng, limits, duration=LONG, centre=centre, frequency=1 / LONG
            )
            out.append(
                (t, motion.position(t), motion.velocity(t), motion.acceleration(t))
            )
        return out

    def recorded(
        self, form: Form, level: float, motions: list[tuple[np.ndarray, ...]]
    ) -> tuple[Recording, ...]:
        """Recordings of motions with noise; the torque is pinocchio's."""
        body, rng, out = RigidBody(self.model), np.random.default_rng(0), []
        for k, (t, q, v, a) in enumerate(motions):
            friction = form(v, q, self.coulomb, self.viscous)
            tau = body.regressor(q, v, a) @ self.bodies + self.rotors * a + friction
            out.append(noised(Recording(f"{k}", t, q, tau), level, rng))
        return tuple(out)
