"""Faults of the torque column alone: gravity left out of it, another unit than N m, or a driver that writes it late.

They are the log's, not the arm's: what moved the joints is as the motion needs it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Look, Values, factors

# Delays of the torque column: starts of the search for one [s]. (budget)
TORQUE_DELAY_STARTS = (0.01, 0.02, 0.04, 0.08, 0.16)
# A torque is in another unit from this factor on, either way [1]; nearer to one it is a constant that is off. (hand)
UNIT_FACTOR = 1.9


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

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """The fault, of an arm that has a weight."""
        return [cls()] if look.has_weight and not look.reading.gravity else []

    def reading(self, n: int) -> Reading:
        """With the gravity torque put back."""
        return Reading.identity(n, gravity=1)


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
    factor: Values = (10.0,)

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

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Another unit of all joints if most are far from the nominal arm; else of those that are, and of each."""
        known = look.known
        usual = float(np.median(look.factor[known])) if known.any() else 1.0
        if _is_gross(usual):
            # a joint whose torque says nothing has the others' factor
            return [
                cls.of(np.arange(look.n), np.where(known, look.factor, usual), look.n)
            ]
        far = np.flatnonzero(known & _is_gross(look.factor))
        groups = [far[k : k + 1] for k in range(len(far))]
        if len(far) > 1:
            groups.append(far)
        return [cls.of(joints, look.factor[joints], look.n) for joints in groups]

    @property
    def is_ordinary(self) -> bool:
        """Whether the unit is near enough to N m for a constant that is off."""
        return bool(not _is_gross(float(np.median(self.factor))))

    @classmethod
    def of(cls, joints: np.ndarray, factor: np.ndarray, n: int) -> TorqueUnit:
        """Of joints, from 0, out of n, with the factor of each."""
        variant = "current" if len(joints) == n else "command_scale"
        return cls(variant, tuple((joints + 1).tolist()), tuple(factor.tolist()))

    def reading(self, n: int) -> Reading:
        """In N m."""
        factor = self.per_joint("factor", len(self.columns(n)))
        return Reading.identity(n, torque=factors(n, self.of_joints(n, factor)))


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

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Some delays, of a torque that is not late already, in a time that is right."""
        late = look.reading.differs("torque_delay", "time_factor")
        return [] if late else [cls("delay", delay) for delay in TORQUE_DELAY_STARTS]

    def reading(self, n: int) -> Reading:
        """At the time of the motion; what a filter took away stays away."""
        return Reading.identity(
            n, torque_delay=self.delay if self.variant == "delay" else 0.0
        )

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the torque late, constant before the start."""
        if self.variant == "delay" or recording.tau is None:
            return super().apply(recording, rng, arm)
        self.check()
        tau = _low_passed(recording.t, recording.tau, self.delay)
        return replace(recording, tau=tau)


def _is_gross(factor: np.ndarray | float) -> np.ndarray:
    """Whether true over recorded torque is that of another unit [1]."""
    return np.abs(np.log(factor)) > np.log(UNIT_FACTOR)


def _low_passed(t: np.ndarray, tau: np.ndarray, time_constant: float) -> np.ndarray:
    """A series [N m], (N, n), behind 1 / (1 + T s), constant before the start and over each step of t [s]."""
    kept = np.exp(-np.diff(t) / time_constant)
    out = np.array(tau)
    for k, share in enumerate(kept, start=1):
        out[k] = share * out[k - 1] + (1.0 - share) * tau[k]
    return out
