"""Faults of the clock: time stamps that are not those of the samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Look

# Assumed over true period: starts of the search for a wrong rate [1]. (budget)
RATE_STARTS = (
    0.2,
    0.25,
    1 / 3,
    0.4,
    0.5,
    0.65,
    0.8,
    1.25,
    1.55,
    2.0,
    2.5,
    3.0,
    4.0,
    5.0,
)


@dataclass(frozen=True)
class TimeStamps(Fault):
    """Time stamps that are not those of the samples.

    Attributes:
        variant: ``gaps`` (stretches lost), ``repeats`` (samples written twice), ``jitter`` (stamps off at random),
            ``wrong_rate`` (stamps made from an assumed rate) or ``torque_clock`` (that of the torque alone).
        amount: share of the samples lost or repeated, jitter over the period, or assumed over true period [1].
    """

    name = "time_stamps"
    scope = "arm"
    looks_like = "steps of time that differ, or torque that fits accelerations of another time scale"
    reference = "ljung1999"
    variants = ("gaps", "repeats", "jitter", "wrong_rate", "torque_clock")
    parameters = (Parameter("amount", "a", "1", (1e-4, 100.0), (0.01, 2.0)),)
    variant: str
    amount: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> TimeStamps:
        """A few per cent lost or repeated, a tenth to a third of jitter, or a rate of which one is the double."""
        variant = str(rng.choice(cls.variants))
        if variant == "wrong_rate":
            return cls(variant, float(rng.choice([0.5, 0.8, 1.25, 2.0])))
        if variant == "torque_clock":
            return cls(variant, float(rng.choice([0.99, 0.995, 1.005, 1.01])))
        low, high = (0.1, 0.3) if variant == "jitter" else (0.01, 0.05)
        return cls(variant, float(rng.uniform(low, high)))

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Wrong rates; all else shows in the recordings themselves."""
        starts = () if look.rate_is_known else RATE_STARTS
        return [cls("wrong_rate", amount) for amount in starts]

    def reading(self, n: int) -> Reading:
        """At the true rate, on an even clock, without repeated rows; samples that were lost stay lost."""
        changed: dict[str, dict[str, float | bool]] = {
            "gaps": {},
            "repeats": {"once": True},
            "jitter": {"even": True},
            "wrong_rate": {"time_factor": 1.0 / self.amount},
            "torque_clock": {"torque_drift": self.amount - 1.0},
        }
        return Reading.identity(n, **changed[self.variant])

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Lose, repeat or shift stamps; what was measured after the recording's end is not in it."""
        at_random = {
            "jitter": self._with_jitter,
            "gaps": self._with_gaps,
            "repeats": self._with_repeats,
        }
        if self.variant in at_random:
            self.check()
            return at_random[self.variant](recording, rng)
        return super().apply(recording, rng, arm)

    def _with_jitter(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Stamps off at random."""
        t = recording.t
        period = float(np.median(np.diff(t)))
        # below half a period, so that the samples keep their order
        shifts = np.clip(self.amount * rng.standard_normal(len(t)), -0.45, 0.45)
        return replace(recording, t=t + period * shifts)

    def _with_gaps(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Three stretches lost."""
        count = len(recording.t)
        length = min(max(1, int(self.amount * count / 3)), count // 4)
        starts = rng.integers(1, count - length, 3)
        lost = np.concatenate([np.arange(s, s + length) for s in starts])
        return recording.part(np.setdiff1d(np.arange(count), lost))

    def _with_repeats(
        self, recording: Recording, rng: np.random.Generator
    ) -> Recording:
        """Samples written once more, each under the stamp of the next."""
        count = len(recording.t)
        repeated = min(max(1, int(self.amount * count)), count // 2)
        late = rng.choice(np.arange(1, count), size=repeated, replace=False)
        rows = np.arange(count)
        rows[late] -= 1
        return replace(recording.part(rows), t=recording.t)
