"""Faults of references and velocities: columns that are not what the controller followed or the arm did."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading, references
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault


@dataclass(frozen=True)
class IgnoredVelocityReference(Fault):
    """A velocity reference in the log that the controller did not use: tau = kp (q_ref - q) - kd dq.

    Attributes:
        lead: kd / kp of the controller at work [s]. A motion under a controller that does use its velocity reference
            is also that of one which ignores it and was given q_ref + (kd / kp) dq_ref, but for its feedforward.
    """

    name = "ignored_velocity_reference"
    scope = "arm"
    looks_like = "position errors in proportion to the speed"
    reference = "siciliano2009"
    parameters = (Parameter("lead", "T", "s", (1e-4, 10.0), (0.02, 0.2)),)
    lead: float = 0.0557

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> IgnoredVelocityReference:
        """Some hundredths to tenths of a second."""
        return cls(float(rng.uniform(*cls.parameters[0].typical)))

    def reading(self, n: int) -> Reading:
        """With the reference that a controller which does use its velocity would have followed."""
        return Reading.identity(n, lead=self.lead)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the reference that leads to the same motion if its velocity is ignored."""
        self.check()
        q_ref, dq_ref = references(recording, self.name)
        # a log whose velocity is that of its positions: no inverse of the reading, which leaves it
        lead = q_ref + self.lead * dq_ref
        rate = np.gradient(lead, recording.t, axis=0)
        return replace(recording, q_ref=lead, dq_ref=rate)


@dataclass(frozen=True)
class VelocityOfReference(Fault):
    """A velocity column that is the reference's: recorded dq = dq_ref, in place of the arm's."""

    name = "velocity_of_reference"
    scope = "arm"
    looks_like = "a velocity that is not the derivative of the recorded position"
    reference = "siciliano2009"

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> VelocityOfReference:
        """The fault, which has no values."""
        return cls()

    def reading(self, n: int) -> Reading:
        """Without the velocity."""
        return Reading.identity(n, own_velocity=False)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the reference's velocity."""
        _, dq_ref = references(recording, self.name)
        return replace(recording, dq=dq_ref)


@dataclass(frozen=True)
class SpeedScaling(Fault):
    """A reference that runs at another pace than the arm: the arm follows q_ref(t0 + s (t - t0)), t0 the first time.

    As a planned trajectory under a speed slider.

    Attributes:
        factor: s, the arm's speed over that of the recorded reference [1].
    """

    name = "speed_scaling"
    scope = "arm"
    looks_like = "position errors that grow with time, as if the arm fell behind"
    reference = "siciliano2009"
    parameters = (Parameter("factor", "s", "1", (0.02, 5.0), (0.1, 0.9)),)
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> SpeedScaling:
        """A slider between a third and nine tenths."""
        return cls(float(rng.uniform(0.33, 0.9)))

    def reading(self, n: int) -> Reading:
        """With the reference at the arm's pace, as long as it lasts."""
        return Reading.identity(n, pace=self.factor)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Let the reference run at its own pace; it rests once it has ended."""
        self.check()
        q_ref, dq_ref = references(recording, self.name)
        t = recording.t
        planned = t[0] + (t - t[0]) / self.factor
        q_planned = [np.interp(planned, t, column) for column in q_ref.T]
        dq_planned = [
            np.interp(planned, t, column, right=0.0) / self.factor
            for column in dq_ref.T
        ]
        return replace(
            recording,
            q_ref=np.column_stack(q_planned),
            dq_ref=np.column_stack(dq_planned),
        )


@dataclass(frozen=True)
class CoarseReference(Fault):
    """A reference that was recorded at a lower rate than the rest, while the controller's own was smooth.

    Attributes:
        variant: ``held`` until the next set point, or ``interpolated`` between two by a straight line.
        period: time from one set point to the next [s].
    """

    name = "coarse_reference"
    scope = "arm"
    looks_like = "steps or corners in the reference which the torque does not show"
    reference = "siciliano2009"
    variants = ("held", "interpolated")
    parameters = (Parameter("period", "T", "s", (1e-3, 1.0), (0.02, 0.1)),)
    variant: str
    period: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> CoarseReference:
        """Set points at 10 to 50 Hz."""
        period = float(rng.choice([0.02, 0.04, 0.1]))
        return cls(str(rng.choice(cls.variants)), period)

    def reading(self, n: int) -> Reading:
        """With a smooth reference through the set points."""
        return Reading.identity(n, smooth_reference=True)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Keep some set points; the velocity's reference is theirs, held alike.

        Raises:
            InputError: set points come no more rarely than rows.
        """
        self.check()
        q_ref, _ = references(recording, self.name)
        t = recording.t
        every = round(self.period * recording.rate)
        if every < 2:
            raise InputError(
                f"set points every {self.period:g} s in a recording at {recording.rate:g} Hz",
                f"give a period of {2 / recording.rate:g} s or more",
                where=f"{self.name}.period",
            )
        kept = np.arange(0, len(t), every)
        before = np.arange(len(t)) // every
        slopes = np.diff(q_ref[kept], axis=0) / np.diff(t[kept])[:, None]
        held_rate = np.vstack([slopes, np.zeros(q_ref.shape[1])])[before]
        if self.variant == "held":
            return replace(recording, q_ref=q_ref[kept][before], dq_ref=held_rate)
        lines = [np.interp(t, t[kept], column) for column in q_ref[kept].T]
        return replace(recording, q_ref=np.column_stack(lines), dq_ref=held_rate)
