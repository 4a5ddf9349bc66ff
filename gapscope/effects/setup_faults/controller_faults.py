"""Faults about the controller: gains that are not those declared, torques that gains gave and nobody measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading, references
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Values

FACTOR = (1e-3, 1e3)
"""Bounds of a factor on a gain [1]."""


@dataclass(frozen=True)
class GainMismatch(Fault):
    """Gains at work that are not those declared, as a firmware's that scales what it is sent.

    Attributes:
        joints: from 1; all if empty.
        kp_factor, kd_factor: gain at work over the declared one [1].
    """

    name = "gain_mismatch"
    scope = "joint"
    looks_like = "torques in proportion to the tracking error, with another factor than the declared gains"
    reference = "siciliano2009"
    parameters = (
        Parameter("kp_factor", "a", "1", FACTOR, (0.1, 30.0)),
        Parameter("kd_factor", "b", "1", FACTOR, (0.01, 10.0)),
    )
    kp_factor: Values
    kd_factor: Values
    joints: tuple[int, ...] = ()

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> GainMismatch:
        """All joints, each gain off by a factor of 1.5 to 10 either way."""
        size = np.exp(rng.uniform(np.log(1.5), np.log(10.0), 2))
        factors = size ** rng.choice([-1, 1], 2)
        return cls((float(factors[0]),), (float(factors[1]),))

    def reading(self, n: int) -> Reading:
        """With the gains at work."""
        count = len(self.columns(n))
        gains = ("kp_factor", "kd_factor")
        by_joint = {x: self.of_joints(n, self.per_joint(x, count)) for x in gains}
        return Reading.identity(n, **by_joint)

    def in_case(self, case: Case, rng: np.random.Generator, vendor: NominalArm) -> Case:
        """The case that declares the gains at work over the factors; its recordings are right.

        Raises:
            InputError: its controller is not ``pd``.
        """
        if not isinstance(case.controller, PD):
            raise InputError(
                "needs a controller of kind pd, whose gains it changes",
                "record under a pd controller",
                where=self.name,
            )
        return super().in_case(case, rng, vendor)


@dataclass(frozen=True)
class UnmeasuredTorque(Fault):
    """A torque column that gains gave, not the arm: recorded tau = kp (q_ref - q) + kd (dq_ref - dq).

    With the gains that a program asked for while others were at work, or behind a drive that controls the position
    itself. With the gains at work it is the torque commanded, and right.

    Attributes:
        joints: from 1; all if empty.
        kp, kd: of the column [N m/rad], [N m s/rad], one for all joints or one for each.
    """

    name = "unmeasured_torque"
    scope = "joint"
    looks_like = "a torque without any noise of its own that does not fit the motion"
    reference = "siciliano2009"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("kp", "kp", "N m/rad", (0.0, 1e6), (10.0, 500.0)),
        Parameter("kd", "kd", "N m s/rad", (0.0, 1e5), (0.5, 20.0)),
    )
    kp: Values = (80.0,)
    kd: Values = (2.5,)
    joints: tuple[int, ...] = ()

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> UnmeasuredTorque:
        """All joints with the same gains."""
        kp, kd = (float(rng.uniform(*p.typical)) for p in cls.parameters)
        return cls((kp,), (kd,))

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write what the gains give in the torque's place."""
        self.check()
        columns = self.columns(recording.n_joints)
        q_ref, dq_ref = references(recording, self.name)
        dq = recording.dq
        if dq is None:
            dq = np.gradient(recording.q, recording.t, axis=0)
        kp, kd = (self.per_joint(gain, len(columns)) for gain in ("kp", "kd"))
        error, rate = q_ref - recording.q, dq_ref - dq
        tau = np.zeros_like(error) if recording.tau is None else np.array(recording.tau)
        tau[:, columns] = kp * error[:, columns] + kd * rate[:, columns]
        return replace(recording, tau=tau)
