"""Faults of channels: signs, joints and units that differ from the assumed ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import (
    POSITIONS,
    TORQUES,
    Fault,
    columns_of,
    scaled,
)


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

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Turn the sign of the channels round."""
        channels = {
            "joint": POSITIONS + TORQUES,
            "position": POSITIONS,
            "torque": TORQUES,
        }
        columns = columns_of(recording, self.joints, self.name)
        return scaled(recording, channels[self.variant], columns, -1.0)


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

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Exchange the columns."""
        if len(set(self.joints)) != 2:
            raise InputError(
                f"expected two joints, got {list(self.joints)}", where=self.name
            )
        first, second = columns_of(recording, self.joints, self.name)
        channels = CHANNELS if self.variant == "joint" else TORQUES
        changed: dict[str, Any] = {}
        for channel in channels:
            series = getattr(recording, channel)
            if series is not None:
                swapped = np.array(series)
                swapped[:, [first, second]] = series[:, [second, first]]
                changed[channel] = swapped
        return replace(recording, **changed)


@dataclass(frozen=True)
class UnitMismatch(Fault):
    """A channel in another unit than assumed.

    Attributes:
        variant: ``degrees`` or ``revolutions`` (positions), ``milliseconds`` (time) or ``motor_side`` (position times
            ratio, torque over ratio).
        joints: from 1; all if empty. Of no meaning for milliseconds.
        ratio: gear ratio of ``motor_side`` [1].
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
    ratio: float = 100.0

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> UnitMismatch:
        """All joints, with one gear ratio."""
        variant = str(rng.choice(cls.variants))
        ratio = np.round(rng.uniform(*cls.parameters[0].typical))
        return cls(variant, ratio=float(ratio))

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Write the channel in the other unit."""
        joints = self.joints or tuple(range(1, recording.n_joints + 1))
        columns = columns_of(recording, joints, self.name)
        if self.variant == "degrees":
            return scaled(recording, POSITIONS, columns, 180.0 / np.pi)
        if self.variant == "revolutions":
            return scaled(recording, POSITIONS, columns, 0.5 / np.pi)
        if self.variant == "milliseconds":
            return replace(recording, t=1e3 * recording.t)
        turned = scaled(recording, POSITIONS, columns, self.ratio)
        return scaled(turned, TORQUES, columns, 1.0 / self.ratio)
