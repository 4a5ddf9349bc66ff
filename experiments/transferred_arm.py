"""The arm of two stories in ``13_identification_stories.py``: what a simulated iiwa knows, and an iiwa that differs."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.model.assembly import Assembly
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor

ARMATURE = (0.6, 0.6, 0.35, 0.35, 0.2, 0.1, 0.08)
COULOMB = (3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5)
VISCOUS = (4.0, 4.0, 2.5, 2.5, 1.5, 1.0, 0.6)
HEAVIER = 1.1
"""Masses of the arm over those of the simulated one."""
FRICTION = (0.5, 1.6)
"""Its friction over that of the simulated one lies between these, joint by joint."""
FREQUENCY = (0.1, 0.25)
"""Base frequency of its motions [Hz]."""


class Transfer:
    """A simulated arm as prior, and the arm that is recorded in its place.

    Args:
        dry: whether both have dry friction.

    Attributes:
        prior: base parameters of the simulated arm, shape (b,).
    """

    def __init__(self, dry: bool = True) -> None:
        sheet = {"armature": list(ARMATURE), "viscous": list(VISCOUS)}
        sheet["coulomb"] = list(COULOMB) if dry else [0.0] * 7
        self._arm = load_nominal_arm("kuka_iiwa", sheet=sheet)
        self._regressor = Regressor(self._arm)
        self._base = structural_base(self._regressor, np.random.default_rng(0))
        self._build = Assembly(
            self._regressor, self._base, position_cutoff=20.0, every=5
        )
        self.prior = self._base.of(self._regressor.nominal())
        self._effects = self._difference(np.random.default_rng(0), dry)

    def _difference(
        self, rng: np.random.Generator, dry: bool
    ) -> tuple[AppliedEffect, ...]:
        """Masses 10 % larger about the same centres, and other friction."""
        joints = tuple(range(1, 8))
        mass = (HEAVIER - 1) * RigidBody(self._arm).inertial_parameters().reshape(
            -1, 10
        )[:, 0]
        scale = rng.uniform(*FRICTION, (2, 7)) - 1
        links = tuple(
            AppliedEffect(
                "link_inertia", (), {"link": joint, "mass": gained, "com": np.zeros(3)}
            )
            for joint, gained in zip(joints, mass, strict=True)
        )
        viscous = AppliedEffect(
            "viscous_friction", joints, {"coefficient": scale[0] * VISCOUS}
        )
        coulomb = AppliedEffect(
            "coulomb_friction", joints, {"torque": scale[1] * COULOMB}
        )
        return (*links, viscous, coulomb) if dry else (*links, viscous)

    def recorded(
        self,
        duration: float,
        seed: int,
        more: tuple[AppliedEffect, ...] = (),
        noise: float = 0.05,
        draw: int = 0,
    ) -> Recording:
        """A random Fourier motion in PyBullet.

        Args:
            duration: [s].
            seed: of the motion.
            more: effects beyond those of the arm.
            noise: of the torque over the joint's standard deviation [1].
            draw: of the noise.
        """
        rng = np.random.default_rng(seed)
        limits = urdf_limits(RigidBody(self._arm), 6.0)._replace(
            velocity=np.full(7, 1.5)
        )
        motion = Fourier.random(
            rng,
            limits,
            duration=max(duration, 10.0),
            centre=POSTURE,
            frequency=rng.uniform(*FREQUENCY),
            ramp=0.5,
        )
        controller = position_controller(self._arm, POSTURE)
        made = record(
            self._arm,
            (*self._effects, *more),
            motion,
            controller,
            duration=duration + 1.0,
            rng=rng,
        )
        assert made.tau is not None
        white = np.random.default_rng([seed, draw]).standard_normal(made.tau.shape)
        return Recording(
            made.name, made.t, made.q, made.tau + noise * made.tau.std(axis=0) * white
        )

    def problem(self, *recordings: Recording) -> Problem:
        """Base columns and torque, a group for each recording."""
        return self._build(recordings)
