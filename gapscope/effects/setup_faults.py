"""Faults of the set-up as they are put into recordings: channels, torque, references, clocks, controllers."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from numbers import Integral
from typing import ClassVar, NamedTuple

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Columns, Reading, interpolated, references
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter

# Setup faults: what is wrong with the set-up, not with the arm; tested before any physics, since they look like it.
#
# A fault is a reading: the one that puts right what a set-up with the fault has recorded. A diagnosis looks for it
# among candidates, which are faults with values; recordings with the fault are made by the inverse of its reading.
# What no reading brings back, such as stamps off at random, has an ``apply`` of its own.
#
# In files of the form of ``corrected.yaml`` a fault is an entry of ``effects`` with its ``joints``, ``variant`` and
# ``parameters``, as ``diagnosis.json`` has it.


Values = float | tuple[float, ...]
"""One value for all joints of a fault, or one for each."""


class Look(NamedTuple):
    """What a case shows under a reading, from which faults tell where they may be, n joints; joints count from 0.

    Attributes:
        reading: how the case is read.
        turning: joints that turn; others slide.
        beyond: joints that travel farther than they can.
        factor: nominal torque over the torque read, (n,) [1], ...
        known: ...and of which joints it is known, (n,).
        has_weight: whether gravity moves any joint of the arm.
        rate_is_known: whether recorded velocities, or a rate put right, settle the clock's rate.
    """

    reading: Reading
    turning: tuple[int, ...]
    beyond: tuple[int, ...]
    factor: np.ndarray
    known: np.ndarray
    has_weight: bool
    rate_is_known: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.factor)


@dataclass(frozen=True)
class Fault:
    """One fault with its values.

    Attributes:
        name: name of the fault.
        scope: ``joint`` or ``arm``.
        looks_like: what gives it away in data.
        reference: source of the convention that the set-up breaks; a key of ``docs/references.md``.
        variants: its kinds, which the field ``variant`` names; empty if there is one only.
        parameters: its parameters, which are fields of the same name.
    """

    name: ClassVar[str]
    scope: ClassVar[str]
    looks_like: ClassVar[str]
    reference: ClassVar[str] = "siciliano2009"
    variants: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __post_init__(self) -> None:
        """Lists of values become tuples; raises ``InputError`` if the variant does not exist."""
        for parameter in self.parameters:
            value = getattr(self, parameter.name)
            if np.ndim(value):
                # a frozen record: set here, before anyone sees it
                object.__setattr__(self, parameter.name, tuple(map(float, value)))
        if self.variants:
            variant = getattr(self, "variant")  # noqa: B009 (a field of the subclass)
            check_known("variant", variant, self.variants, where=self.name)

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """The faults of this kind that may be in a case, continuous values at some starts; none if others find it."""
        return []

    def reading(self, n: int) -> Reading:
        """How recordings with the fault must be read, of n joints; as they are, if nothing brings back what is lost.

        Raises:
            InputError: the fault names a joint that the arm does not have, or has neither one value nor one per joint.
        """
        return Reading.identity(n)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """The recording as a set-up with this fault would have written it.

        Args:
            recording: a right one.
            rng: source of random numbers.
            arm: the nominal arm, which is also the vendor's model in the driver.

        Raises:
            InputError: the fault names a joint that the recording does not have, or a value is out of bounds.
        """
        self.check()
        # what puts a fault right, backwards
        return self.reading(recording.n_joints).inverse()(recording, arm)

    def in_case(self, case: Case, rng: np.random.Generator, vendor: NominalArm) -> Case:
        """The case as a set-up with this fault would have written it: recordings, nominal arm and controller.

        Args:
            case: a right one.
            rng: source of random numbers.
            vendor: the arm of the driver's model, which no fault spoils.
        """
        self.check()
        spoil = self.reading(case.arm.n_joints).inverse()
        return replace(
            case,
            recordings=tuple(self.apply(r, rng, vendor) for r in case.recordings),
            arm=spoil.arm(case.arm),
            controller=spoil.controller(case.controller),
        )

    def check(self) -> None:
        """Raise ``InputError`` if joints are none, or a value is out of bounds; that of a found fault may be."""
        joints = self.kind[2]
        whole = all(isinstance(joint, Integral) and joint >= 1 for joint in joints)
        if not whole or len(set(joints)) != len(joints):
            raise InputError(
                f"joints count from 1 and occur once, got {joints}",
                "give their numbers, joints: [1, ...]",
                where=self.name,
            )
        for parameter in self.parameters:
            value = getattr(self, parameter.name)
            low, high = parameter.bounds
            least, most = parameter.typical
            values = np.atleast_1d(value)
            # written so that nan is refused too
            if not ((values >= low) & (values <= high)).all():
                raise InputError(
                    f"value {value} outside {low:g} .. {high:g}",
                    f"real set-ups have {least:g} .. {most:g}",
                    where=f"{self.name}.{parameter.name}",
                )

    @property
    def kind(self) -> tuple[str, str, tuple[int, ...]]:
        """Name; variant, empty if there is one only; joints, from 1, empty if they are all or the arm."""
        return self.name, getattr(self, "variant", ""), getattr(self, "joints", ())

    def values(self) -> dict[str, tuple[float, ...]]:
        """Values of its parameters by name, one for each of its joints or one for the arm."""
        count = max(len(self.kind[2]), 1)
        named = (parameter.name for parameter in self.parameters)
        return {name: tuple(self.per_joint(name, count).tolist()) for name in named}

    def joined(self, other: Fault) -> Fault:
        """The same fault on its own joints and those of another, in order."""
        joints = np.array(self.kind[2] + other.kind[2])
        order = np.argsort(joints)
        changed = {"joints": tuple(joints[order].tolist())}
        theirs = other.values()
        for name, own in self.values().items():
            changed[name] = tuple(np.array(own + theirs[name])[order].tolist())
        return replace(self, **changed)

    def columns(self, n: int) -> np.ndarray:
        """Columns, from 0, of its joints, all n if it names none; raises ``InputError`` for joints that are not."""
        joints = self.kind[2] or tuple(range(1, n + 1))
        if min(joints) < 1 or max(joints) > n:
            raise InputError(
                f"joints {list(joints)} of an arm with {n} joints",
                f"joints count from 1 to {n} in the case's order",
                where=self.name,
            )
        return np.array(joints) - 1

    def per_joint(self, name: str, count: int) -> np.ndarray:
        """A parameter for each of ``count`` joints, (count,); one value stands for all.

        Raises:
            InputError: there are neither one nor ``count`` values.
        """
        values = np.atleast_1d(getattr(self, name)).astype(float)
        if len(values) not in (1, count):
            raise InputError(
                f"{len(values)} values for {count} joints",
                "give one value, or one for each joint",
                where=f"{self.name}.{name}",
            )
        return np.broadcast_to(values, (count,))

    def of_joints(
        self, n: int, values: np.ndarray | float, usual: float = 1.0
    ) -> tuple[float, ...]:
        """Values of its joints, and the usual one of all others, (n,)."""
        out = np.full(n, usual)
        out[self.columns(n)] = values
        return tuple(out.tolist())


def factors(n: int, factor: tuple[float, ...]) -> Columns:
    """Columns of n joints times factors [1]."""
    return replace(Columns.identity(n), factor=factor)


# Faults of channels: signs, joints, units and zeros that differ from the assumed ones.


# Gear ratios: starts of the search for one [1]. (physical)
GEAR_RATIO_STARTS = tuple(float(r) for r in np.geomspace(2.0, 500.0, 28))
# Zeros of joints off by large angles: starts of the search for one [rad]. (budget)
ZERO_STARTS = tuple(float(a) for a in np.deg2rad((-135, -90, -45, 45, 90, 135, 180)))
# With fewer joints that travel too far, each is tried by itself as one read on its motor's side. (budget)
FEW_FAR_JOINTS = 4


@dataclass(frozen=True)
class SignFlip(Fault):
    """One joint counted the other way round, or its torque.

    Attributes:
        joints: from 1.
        variant: ``joint`` for position and torque, ``position`` or ``torque`` alone.
    """

    name = "sign_flip"
    scope = "joint"
    looks_like = "torque of a joint mirrored against what its motion needs"
    variants = ("torque", "position", "joint")
    joints: tuple[int, ...]
    variant: str = "torque"

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Every joint in every way, and torques of two joints and of all.

        Two flips are tried together: each may hide the other, since links share their inertials.
        """
        joints = range(1, look.n + 1)
        torques = [
            *itertools.combinations(joints, 1),
            *itertools.combinations(joints, 2),
        ]
        # of two joints both are a pair already
        if look.n > 2:
            torques.append(tuple(joints))
        of_motion = [cls((j,), way) for j in joints for way in ("position", "joint")]
        return [*map(cls, torques), *of_motion]

    def reading(self, n: int) -> Reading:
        """With the sign of its channels turned."""
        turned = factors(n, self.of_joints(n, -1.0))
        torques = {"torque": turned, "sensor": turned}
        changed = {
            "torque": torques,
            "position": {"motion": turned},
            "joint": {"motion": turned, **torques},
        }
        return Reading.identity(n, **changed[self.variant])


@dataclass(frozen=True)
class JointSwap(Fault):
    """The columns of two joints exchanged.

    Attributes:
        joints: the two, from 1.
        variant: ``joint`` for all channels, ``torque`` for those of torque.
    """

    name = "joint_swap"
    scope = "joint"
    looks_like = "each of two torques fits the other joint's motion"
    variants = ("torque", "joint")
    joints: tuple[int, int]
    variant: str = "torque"

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Every pair in either way."""
        pairs = list(itertools.combinations(range(1, look.n + 1), 2))
        return [cls(pair, variant) for variant in cls.variants for pair in pairs]

    def reading(self, n: int) -> Reading:
        """With the columns exchanged."""
        if not len(set(self.joints)) == len(self.joints) == 2:
            raise InputError(
                f"expected two joints, got {list(self.joints)}", where=self.name
            )
        first, second = self.columns(n)
        # column of the log from which each joint is read
        source = np.arange(n)
        source[[first, second]] = second, first
        swapped = replace(Columns.identity(n), source=tuple(source.tolist()))
        motion = swapped if self.variant == "joint" else Columns.identity(n)
        return Reading.identity(n, motion=motion, torque=swapped, sensor=swapped)


@dataclass(frozen=True)
class UnitMismatch(Fault):
    """A channel in another unit than assumed.

    Attributes:
        variant: ``degrees`` or ``revolutions`` (positions), ``milliseconds`` (time) or ``motor_side`` (position times
            ratio, torque over ratio).
        joints: from 1; all if empty. Of no meaning for milliseconds.
        ratio: gear ratio of ``motor_side`` [1], one for all joints or one for each.
    """

    name = "unit_mismatch"
    scope = "joint"
    looks_like = (
        "positions, times or torques off by a factor that is a unit's or a gear's"
    )
    variants = ("degrees", "milliseconds", "motor_side", "revolutions")
    parameters = (Parameter("ratio", "r", "1", (1.0, 1000.0), (50.0, 160.0)),)
    variant: str
    joints: tuple[int, ...] = ()
    ratio: Values = 100.0

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Of joints that move too far: degrees on each and on all, motor side; of every joint degrees, revolutions.

        Every joint is in degrees only if most move too far: else the motion would be one of a few degrees.
        """
        far = tuple(j + 1 for j in look.beyond)
        turning = tuple(j + 1 for j in look.turning)
        # a slide has no degrees
        turning_far = tuple(j for j in far if j in turning)
        in_degrees = {(j,) for j in turning_far} | {turning_far}
        if 2 * len(turning_far) > len(turning):
            in_degrees.add(turning)
        # all that move too far, and of a few each alone
        on_motor_side = {far}
        if len(far) < FEW_FAR_JOINTS:
            on_motor_side |= {(j,) for j in far}
        found = [cls("degrees", joints) for joints in sorted(in_degrees) if joints]
        if turning:
            found.append(cls("revolutions", turning))
        geared = itertools.product(sorted(on_motor_side), GEAR_RATIO_STARTS)
        # an empty set of joints would mean all
        return [*found, *(cls("motor_side", *pair) for pair in geared if pair[0])]

    def values(self) -> dict[str, tuple[float, ...]]:
        """The ratio, of ``motor_side`` alone."""
        return super().values() if self.variant == "motor_side" else {}

    def reading(self, n: int) -> Reading:
        """In the unit assumed."""
        if self.variant == "milliseconds":
            return Reading.identity(n, time_factor=1e-3)
        if self.variant == "motor_side":
            ratio = self.per_joint("ratio", len(self.columns(n)))
            # a motor turns r times as far and gives an r-th of the torque
            torque = factors(n, self.of_joints(n, ratio))
            motion = factors(n, self.of_joints(n, 1.0 / ratio))
            return Reading.identity(n, motion=motion, torque=torque, sensor=torque)
        unit = np.pi / 180 if self.variant == "degrees" else 2 * np.pi
        return Reading.identity(n, motion=factors(n, self.of_joints(n, unit)))


@dataclass(frozen=True)
class ZeroOffset(Fault):
    """Angles of joints counted from another zero than the model's: recorded q = q + offset.

    As between an arm's Denavit-Hartenberg parameters and its URDF. Angles of a few degrees are no matter of convention:
    they are the effect ``encoder_offset``.

    Attributes:
        joints: from 1.
        offset: recorded less true angle [rad], one for all joints or one for each.
    """

    name = "zero_offset"
    scope = "joint"
    looks_like = (
        "gravity torque as if a joint and what hangs on it were turned by a large angle"
    )
    parameters = (
        Parameter("offset", "delta", "rad", (-np.pi, np.pi), (-np.pi / 2, np.pi / 2)),
    )
    joints: tuple[int, ...]
    offset: Values

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Each joint by eighths of a turn."""
        # one joint at a time: others are found on top of it
        return [cls((j,), a) for j in range(1, look.n + 1) for a in ZERO_STARTS]

    def reading(self, n: int) -> Reading:
        """Positions and their references counted from the model's zero."""
        offset = self.per_joint("offset", len(self.columns(n)))
        back = self.of_joints(n, -offset, usual=0.0)
        return Reading.identity(n, motion=replace(Columns.identity(n), offset=back))


# Faults of the torque column alone: gravity left out of it, another unit than N m, or a driver that writes it late.
#
# They are the log's, not the arm's: what moved the joints is as the motion needs it.


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
    def candidates(cls, look: Look) -> list[Fault]:
        """Another unit of all joints if most are far from the nominal arm; else of those that are, and of each."""
        known = look.known
        usual = float(np.median(look.factor[known])) if known.any() else 1.0
        if _is_gross(usual):
            # a joint whose torque says nothing has the others' factor, and in one unit all have the same
            every = np.arange(look.n)
            alike = np.full(look.n, usual)
            own = np.where(known, look.factor, usual)
            return [cls.of(every, factor, look.n) for factor in (own, alike)]
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
    def candidates(cls, look: Look) -> list[Fault]:
        """Some delays, of a torque that is not late already, in a time that is right."""
        # under a wrong rate any torque looks late
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
        # behind 1 / (1 + T s), constant over each step
        kept = np.exp(-np.diff(recording.t) / self.delay)
        tau = np.array(recording.tau)
        for k, share in enumerate(kept, start=1):
            tau[k] = share * tau[k - 1] + (1.0 - share) * recording.tau[k]
        return replace(recording, tau=tau)


def _is_gross(factor: np.ndarray | float) -> np.ndarray:
    """Whether true over recorded torque is that of another unit [1]."""
    return np.abs(np.log(factor)) > np.log(UNIT_FACTOR)


# Faults of the clock: time stamps that are not those of the samples.


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
    def candidates(cls, look: Look) -> list[Fault]:
        """Wrong rates; all else shows in the recordings themselves."""
        # recorded velocities, or a rate put right, have settled it already
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
        self.check()
        t, count = recording.t, len(recording.t)
        if self.variant == "jitter":
            period = float(np.median(np.diff(t)))
            # below half a period, so that the samples keep their order
            shifts = np.clip(self.amount * rng.standard_normal(count), -0.45, 0.45)
            return replace(recording, t=t + period * shifts)
        if self.variant == "gaps":
            # three stretches
            length = min(max(1, int(self.amount * count / 3)), count // 4)
            starts = rng.integers(1, count - length, 3)
            lost = np.concatenate([np.arange(s, s + length) for s in starts])
            return recording.part(np.setdiff1d(np.arange(count), lost))
        if self.variant == "repeats":
            # samples written once more, each under the stamp of the next
            repeated = min(max(1, int(self.amount * count)), count // 2)
            late = rng.choice(np.arange(1, count), size=repeated, replace=False)
            rows = np.arange(count)
            rows[late] -= 1
            return replace(recording.part(rows), t=t)
        return super().apply(recording, rng, arm)


# Faults of references and velocities: columns that are not what the controller followed or the arm did.


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
    parameters = (Parameter("lead", "T", "s", (1e-4, 10.0), (0.02, 0.2)),)
    lead: float = 0.0557

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
    parameters = (Parameter("factor", "s", "1", (0.02, 5.0), (0.1, 0.9)),)
    factor: float

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
        # at t the plan is where the arm will be at t0 + (t - t0) / s
        planned = t[0] + (t - t[0]) / self.factor
        rate = interpolated(planned, t, dq_ref) / self.factor
        # positions stay at their last value by themselves
        rate[planned > t[-1]] = 0.0
        return replace(recording, q_ref=interpolated(planned, t, q_ref), dq_ref=rate)


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
    variants = ("held", "interpolated")
    parameters = (Parameter("period", "T", "s", (1e-3, 1.0), (0.02, 0.1)),)
    variant: str
    period: float

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
        # number of the set point before each row
        before = np.arange(len(t)) // every
        # from one set point to the next
        slopes = np.diff(q_ref[kept], axis=0) / np.diff(t[kept])[:, None]
        # behind the last set point nothing is planned
        held_rate = np.vstack([slopes, np.zeros(q_ref.shape[1])])[before]
        if self.variant == "held":
            return replace(recording, q_ref=q_ref[kept][before], dq_ref=held_rate)
        lines = interpolated(t, t[kept], q_ref[kept])
        return replace(recording, q_ref=lines, dq_ref=held_rate)


# Faults about the controller: gains that are not those declared, torques that gains gave and nobody measured.


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
    parameters = (
        Parameter("kp_factor", "a", "1", FACTOR, (0.1, 30.0)),
        Parameter("kd_factor", "b", "1", FACTOR, (0.01, 10.0)),
    )
    kp_factor: Values
    kd_factor: Values
    joints: tuple[int, ...] = ()

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
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("kp", "kp", "N m/rad", (0.0, 1e6), (10.0, 500.0)),
        Parameter("kd", "kd", "N m s/rad", (0.0, 1e5), (0.5, 20.0)),
    )
    kp: Values = (80.0,)
    kd: Values = (2.5,)
    joints: tuple[int, ...] = ()

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
        # joints that are not named keep what was recorded
        tau = np.zeros_like(error) if recording.tau is None else np.array(recording.tau)
        tau[:, columns] = kp * error[:, columns] + kd * rate[:, columns]
        return replace(recording, tau=tau)


# A fault of the nominal arm's file: inertials on the neighbouring link.


@dataclass(frozen=True)
class ShiftedInertials(Fault):
    """The inertials of the nominal arm's URDF assigned to the neighbouring link.

    Attributes:
        by: how many links further [1].
        moved_only: whether links that no joint moves, such as the base, kept theirs.
    """

    name = "shifted_inertials"
    scope = "arm"
    looks_like = "gravity torque of every joint off by that of a link"
    reference = "hollerbach2008"
    parameters = (Parameter("by", "k", "1", (-6.0, 6.0), (-1.0, 1.0)),)
    by: int = 1
    moved_only: bool = False

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """One link off either way, among all links or among those that a joint moves."""
        return [cls(by, moved) for moved in (False, True) for by in (1, -1)]

    def check(self) -> None:
        """Raise ``InputError`` if it is no number of links, or out of bounds."""
        super().check()
        if self.by % 1:
            raise InputError(
                f"a number of links is whole, got {self.by}",
                "give 1 or -1, or another whole number",
                where=f"{self.name}.by",
            )

    def reading(self, n: int) -> Reading:
        """With the inertials back where they belong."""
        return Reading.identity(n, link_shift=-int(self.by), moved_only=self.moved_only)


# The setup faults by name.


FAULTS: dict[str, type[Fault]] = {
    fault.name: fault
    for fault in (
        SignFlip,
        JointSwap,
        UnitMismatch,
        ShiftedInertials,
        TimeStamps,
        GravityCompensatedTorque,
        TorqueUnit,
        LateTorque,
        ZeroOffset,
        IgnoredVelocityReference,
        VelocityOfReference,
        SpeedScaling,
        CoarseReference,
        GainMismatch,
        UnmeasuredTorque,
    )
}
"""The setup faults by name."""
