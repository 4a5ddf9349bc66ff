"""Setup faults: what is wrong with the set-up, not with the arm; tested before any physics, since they look like it.

A fault is found in recordings and made in them: ``apply`` gives the recording that a set-up with this fault would have
written. ``ShiftedInertials`` is the exception: it spoils the nominal arm's URDF, not the recording.

In files of the form of ``corrected.yaml`` a fault is an entry of ``effects`` with its ``joints``, ``variant`` and
``parameters``, as ``diagnosis.json`` has it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.effects.effect import Parameter

POSITIONS = ("q", "dq", "q_ref", "dq_ref")
TORQUES = ("tau", "tau_sensor")


@dataclass(frozen=True)
class Fault(ABC):
    """One fault with its values.

    Attributes:
        name: name of the fault.
        scope: ``joint`` or ``arm``.
        looks_like: what gives it away in data.
        reference: where the convention stands that the set-up breaks; a key of ``docs/references.md``.
        variants: its kinds, which the field ``variant`` names; empty where there is one only.
        parameters: its parameters, which are fields of the same name.
    """

    name: ClassVar[str]
    scope: ClassVar[str]
    looks_like: ClassVar[str]
    reference: ClassVar[str]
    variants: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __post_init__(self) -> None:
        """Check variant and values; raises ``InputError`` where they do not exist or lie out of bounds."""
        if self.variants:
            variant = getattr(self, "variant")  # noqa: B009 (a field of the subclass)
            check_known("variant", variant, self.variants, where=self.name)
        for parameter in self.parameters:
            value, (low, high) = getattr(self, parameter.name), parameter.bounds
            if not (np.isfinite(value) and low <= value <= high):
                raise InputError(
                    f"value {value} outside {low:g} .. {high:g}",
                    f"real set-ups have {parameter.typical[0]:g} .. {parameter.typical[1]:g}",
                    where=f"{self.name}.{parameter.name}",
                )

    @classmethod
    @abstractmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> Fault:
        """A fault as real set-ups have it, on an arm with n joints."""

    @abstractmethod
    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording as a set-up with this fault would have written it.

        Raises:
            InputError: the fault names a joint that the recording does not have.
        """


def _columns(recording: Recording, joints: tuple[int, ...], name: str) -> np.ndarray:
    """Columns of joints that count from 1."""
    if not joints or min(joints) < 1 or max(joints) > recording.n_joints:
        raise InputError(
            f"joints {list(joints)} of an arm with {recording.n_joints} joints",
            f"joints count from 1 to {recording.n_joints} in the case's order",
            where=name,
        )
    return np.array(joints) - 1


def _scaled(
    recording: Recording, channels: tuple[str, ...], columns: np.ndarray, factor: float
) -> Recording:
    changed: dict[str, Any] = {}
    for channel in channels:
        series = getattr(recording, channel)
        if series is not None:
            changed[channel] = np.array(series)
            changed[channel][:, columns] *= factor
    return replace(recording, **changed)


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

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Turn the sign of the channels round."""
        channels = {
            "joint": POSITIONS + TORQUES,
            "position": POSITIONS,
            "torque": TORQUES,
        }
        return _scaled(
            recording,
            channels[self.variant],
            _columns(recording, self.joints, self.name),
            -1.0,
        )


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

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Exchange the columns."""
        if len(set(self.joints)) != 2:
            raise InputError(
                f"expected two joints, got {list(self.joints)}", where=self.name
            )
        first, second = _columns(recording, self.joints, self.name)
        channels = CHANNELS if self.variant == "joint" else TORQUES
        changed: dict[str, Any] = {}
        for channel in channels:
            series = getattr(recording, channel)
            if series is not None:
                changed[channel] = np.array(series)
                changed[channel][:, [first, second]] = changed[channel][
                    :, [second, first]
                ]
        return replace(recording, **changed)


@dataclass(frozen=True)
class UnitMismatch(Fault):
    """A channel in another unit than it is taken for.

    Attributes:
        variant: ``degrees`` (positions), ``milliseconds`` (time) or ``motor_side`` (position times ratio, torque over
            ratio).
        joints: from 1; all where empty. Of no meaning for milliseconds.
        ratio: gear ratio of ``motor_side`` [1].
    """

    name = "unit_mismatch"
    scope = "joint"
    looks_like = (
        "positions, times or torques off by a factor that is a unit's or a gear's"
    )
    reference = "siciliano2009"
    variants = ("degrees", "milliseconds", "motor_side")
    parameters = (Parameter("ratio", "r", "1", (1.0, 1000.0), (50.0, 160.0)),)
    variant: str
    joints: tuple[int, ...] = ()
    ratio: float = 100.0

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> UnitMismatch:
        """All joints, with one gear ratio."""
        return cls(
            str(rng.choice(cls.variants)),
            ratio=float(np.round(rng.uniform(*cls.parameters[0].typical))),
        )

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Write the channel in the other unit."""
        joints = self.joints or tuple(range(1, recording.n_joints + 1))
        columns = _columns(recording, joints, self.name)
        if self.variant == "degrees":
            return _scaled(recording, POSITIONS, columns, 180.0 / np.pi)
        if self.variant == "milliseconds":
            return replace(recording, t=1e3 * recording.t)
        turned = _scaled(recording, POSITIONS, columns, self.ratio)
        return _scaled(turned, TORQUES, columns, 1.0 / self.ratio)


@dataclass(frozen=True)
class TimeStamps(Fault):
    """Time stamps that are not those of the samples.

    Attributes:
        variant: ``gaps`` (stretches lost), ``repeats`` (samples written twice), ``jitter`` (stamps off at random) or
            ``wrong_rate`` (stamps made from an assumed rate).
        amount: share of the samples lost or repeated, jitter over the period, or assumed over true period [1].
    """

    name = "time_stamps"
    scope = "arm"
    looks_like = "steps of time that differ, or torque that fits accelerations of another time scale"
    reference = "ljung1999"
    variants = ("gaps", "repeats", "jitter", "wrong_rate")
    parameters = (Parameter("amount", "a", "1", (1e-4, 100.0), (0.01, 2.0)),)
    variant: str
    amount: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> TimeStamps:
        """A few per cent lost or repeated, a tenth to a third of jitter, or a rate of which one is the double."""
        variant = str(rng.choice(cls.variants))
        if variant == "wrong_rate":
            return cls(variant, float(rng.choice([0.5, 0.8, 1.25, 2.0])))
        return cls(
            variant,
            float(rng.uniform(*((0.1, 0.3) if variant == "jitter" else (0.01, 0.05)))),
        )

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Lose, repeat or shift stamps."""
        t, count = recording.t, len(recording.t)
        if self.variant == "wrong_rate":
            return replace(recording, t=t[0] + (t - t[0]) * self.amount)
        if self.variant == "jitter":
            period = float(np.median(np.diff(t)))
            shifts = np.clip(self.amount * rng.standard_normal(count), -0.45, 0.45)
            return replace(recording, t=t + period * shifts)
        if self.variant == "gaps":
            length = min(max(1, int(self.amount * count / 3)), count // 4)
            lost = np.concatenate(
                [np.arange(s, s + length) for s in rng.integers(1, count - length, 3)]
            )
            return _rows(recording, np.setdiff1d(np.arange(count), lost))
        twice = rng.choice(
            np.arange(1, count),
            size=min(max(1, int(self.amount * count)), count // 2),
            replace=False,
        )
        rows = np.arange(count)
        rows[twice] -= 1  # the sample before is written once more, under a new stamp
        return replace(_rows(recording, rows), t=t)


def _rows(recording: Recording, rows: np.ndarray) -> Recording:
    channels: dict[str, Any] = {
        name: getattr(recording, name) for name in ("t", *CHANNELS)
    }
    return replace(
        recording,
        **{
            name: series[rows]
            for name, series in channels.items()
            if series is not None
        },
    )


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
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ShiftedInertials:
        """One link up or down the chain."""
        return cls(int(rng.choice([-1, 1])), bool(rng.integers(2)))

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording, which is right; see ``urdf``."""
        return recording

    def urdf(self, text: str) -> str:
        """URDF text with the ``<inertial>`` of each link that has one moved to the next such link, in file order."""
        root = ET.fromstring(text)
        moving = [
            joint
            for joint in root.iter("joint")
            if joint.get("type") in ("revolute", "continuous", "prismatic")
        ]
        turned = {
            child.get("link") for joint in moving for child in joint.iter("child")
        }
        links = [
            link
            for link in root.iter("link")
            if link.find("inertial") is not None
            and (not self.moved_only or link.get("name") in turned)
        ]
        inertials = [link.find("inertial") for link in links]
        for link, own, given in zip(
            links, inertials, np.roll(np.arange(len(links)), self.by), strict=True
        ):
            assert own is not None
            link.remove(own)
            moved = inertials[int(given)]
            assert moved is not None
            link.append(moved)
        return ET.tostring(root, encoding="unicode")


FAULTS: dict[str, type[Fault]] = {
    fault.name: fault
    for fault in (SignFlip, JointSwap, UnitMismatch, ShiftedInertials, TimeStamps)
}
"""The setup faults by name."""
