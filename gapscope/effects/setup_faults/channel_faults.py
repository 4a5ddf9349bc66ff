"""Faults of channels: signs, joints, units and zeros that differ from the assumed ones."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.reading import Columns, Reading
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Look, Values, factors

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
    reference = "siciliano2009"
    variants = ("torque", "position", "joint")
    joints: tuple[int, ...]
    variant: str = "torque"

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> SignFlip:
        """One joint."""
        return cls((int(rng.integers(n_joints)) + 1,), str(rng.choice(cls.variants)))

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
    reference = "siciliano2009"
    variants = ("torque", "joint")
    joints: tuple[int, int]
    variant: str = "torque"

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> JointSwap:
        """Two joints that follow each other, as cables in the wrong order have it."""
        first = int(rng.integers(1, n_joints))
        return cls((first, first + 1), str(rng.choice(cls.variants)))

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Every pair in either way."""
        pairs = list(itertools.combinations(range(1, look.n + 1), 2))
        return [cls(pair, variant) for variant in cls.variants for pair in pairs]

    def reading(self, n: int) -> Reading:
        """With the columns exchanged."""
        if len(set(self.joints)) != 2:
            raise InputError(
                f"expected two joints, got {list(self.joints)}", where=self.name
            )
        first, second = self.columns(n)
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
    reference = "siciliano2009"
    variants = ("degrees", "milliseconds", "motor_side", "revolutions")
    parameters = (Parameter("ratio", "r", "1", (1.0, 1000.0), (50.0, 160.0)),)
    variant: str
    joints: tuple[int, ...] = ()
    ratio: Values = 100.0

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> UnitMismatch:
        """All joints, with one gear ratio."""
        variant = str(rng.choice(cls.variants))
        ratio = np.round(rng.uniform(*cls.parameters[0].typical))
        return cls(variant, ratio=float(ratio))

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Degrees on each joint, all, and those that move too far; revolutions on all; motor side on those too far."""
        far = tuple(j + 1 for j in look.beyond)
        turning = tuple(j + 1 for j in look.turning)
        in_degrees = {(j,) for j in turning} | {turning}
        # joints that travel too far probably share one cause
        in_degrees.add(tuple(j for j in far if j in turning))
        on_motor_side = {far}
        if len(far) < FEW_FAR_JOINTS:
            on_motor_side |= {(j,) for j in far}
        found = [cls("degrees", joints) for joints in sorted(in_degrees) if joints]
        if turning:
            found.append(cls("revolutions", turning))
        geared = itertools.product(sorted(on_motor_side), GEAR_RATIO_STARTS)
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
    reference = "siciliano2009"
    parameters = (
        Parameter("offset", "delta", "rad", (-np.pi, np.pi), (-np.pi / 2, np.pi / 2)),
    )
    joints: tuple[int, ...]
    offset: Values

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ZeroOffset:
        """One joint, by a quarter of a turn either way or by half a turn."""
        joint = int(rng.integers(n_joints)) + 1
        return cls((joint,), float(rng.choice([-1, 1, 2])) * np.pi / 2)

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Each joint by eighths of a turn."""
        return [cls((j,), a) for j in range(1, look.n + 1) for a in ZERO_STARTS]

    def reading(self, n: int) -> Reading:
        """Positions and their references counted from the model's zero."""
        offset = self.per_joint("offset", len(self.columns(n)))
        back = self.of_joints(n, -offset, usual=0.0)
        return Reading.identity(n, motion=replace(Columns.identity(n), offset=back))
