"""Faults of the torque column alone: gravity left out of it, another unit than N m, or a driver that writes it late.

They are the log's, not the arm's: what moved the joints is as the motion needs it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.torque_column import gravity_torque
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, columns_of


@dataclass(frozen=True)
class GravityCompensatedTorque(Fault):
    """The gravity torque of the vendor's model left out of the torque: recorded = tau - g(q), g of the nominal arm.

    As UR's ``actual_current_as_torque`` and Franka's ``tau_J_d``.
    """

    name = "gravity_compensated_torque"
    scope = "arm"
    looks_like = (
        "torque needed for acceleration and friction alone, as if nothing had weight"
    )
    reference = "siciliano2009"

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> GravityCompensatedTorque:
        """The fault, which has no values."""
        return cls()

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Take the gravity torque out."""
        if recording.tau is None:
            return recording
        return replace(recording, tau=recording.tau - gravity_torque(recording, arm))


@dataclass(frozen=True)
class TorqueUnit(Fault):
    """A torque column in another unit than N m: recorded = tau / factor. The joint torque sensors are right.

    Attributes:
        variant: ``current``, all joints, as motor currents are; ``command_scale``, some of them, as commands that a
            driver multiplies.
        joints: from 1; all if empty.
        factor: true torque over recorded value [N m per unit of the column], one for all joints or one for each.
    """

    name = "torque_unit"
    scope = "joint"
    looks_like = "torque off by a factor that no arm's constants or bodies explain"
    reference = "gautier2014"
    variants = ("current", "command_scale")
    parameters = (Parameter("factor", "k", "1", (1e-4, 1e4), (0.1, 20.0)),)
    variant: str
    joints: tuple[int, ...] = ()
    factor: tuple[float, ...] = (10.0,)

    def __post_init__(self) -> None:
        """One factor, or one for each joint."""
        factors = np.atleast_1d(self.factor).astype(float)
        object.__setattr__(self, "factor", tuple(factors.tolist()))
        super().__post_init__()

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> TorqueUnit:
        """Currents of motors of two sizes, or commands of the first joints times a round number."""
        variant = str(rng.choice(cls.variants))
        if variant == "command_scale":
            count = int(rng.integers(1, max(n_joints, 2)))
            times = float(rng.choice([4.0, 10.0, 0.25, 0.1]))
            return cls(variant, tuple(range(1, count + 1)), (1.0 / times,))
        large = float(np.exp(rng.uniform(np.log(2.5), np.log(20.0))))
        small = large * float(rng.uniform(0.4, 0.9))
        halves = [large if 2 * j < n_joints else small for j in range(n_joints)]
        return cls(variant, factor=tuple(halves))

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the torque in the other unit."""
        joints = self.joints or tuple(range(1, recording.n_joints + 1))
        columns = columns_of(recording, joints, self.name)
        factors = self.per_joint("factor", len(columns))
        if recording.tau is None:
            return recording
        tau = np.array(recording.tau)
        tau[:, columns] /= factors
        return replace(recording, tau=tau)


@dataclass(frozen=True)
class LateTorque(Fault):
    """A torque that the driver filters or sends late against the positions, all joints alike.

    Attributes:
        variant: ``delay``, recorded(t) = tau(t - T); ``filter``, T d recorded / dt + recorded = tau.
        delay: T [s].
    """

    name = "late_torque"
    scope = "arm"
    looks_like = "torque that follows the acceleration of a moment ago"
    reference = "ljung1999"
    variants = ("delay", "filter")
    parameters = (Parameter("delay", "T", "s", (1e-4, 0.2), (0.02, 0.1)),)
    variant: str
    delay: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> LateTorque:
        """A few hundredths of a second."""
        variant = str(rng.choice(cls.variants))
        return cls(variant, float(rng.uniform(*cls.parameters[0].typical)))

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the torque late, constant before the start."""
        if recording.tau is None:
            return recording
        t = recording.t
        if self.variant == "filter":
            return replace(recording, tau=_low_passed(t, recording.tau, self.delay))
        late = [np.interp(t - self.delay, t, column) for column in recording.tau.T]
        return replace(recording, tau=np.column_stack(late))


def _low_passed(t: np.ndarray, tau: np.ndarray, time_constant: float) -> np.ndarray:
    """A series [N m], (N, n), behind 1 / (1 + T s), constant before the start and over each step of t [s]."""
    kept = np.exp(-np.diff(t) / time_constant)
    out = np.array(tau)
    for k, share in enumerate(kept, start=1):
        out[k] = share * out[k - 1] + (1.0 - share) * tau[k]
    return out
