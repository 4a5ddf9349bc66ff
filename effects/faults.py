"""Setup faults: what is wrong with the set-up, not with the arm; tested before any physics, since they look like it.

A fault is found in recordings and made in them: ``apply`` gives the recording that a set-up with this fault would have
written. ``ShiftedInertials`` is the exception: it spoils the nominal arm's URDF, not the recording.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from arm.errors import InputError
from arm.recording import CHANNELS, Recording

POSITIONS = ("q", "dq", "q_ref", "dq_ref")
TORQUES = ("tau", "tau_sensor")


@dataclass(frozen=True)
class Fault(ABC):
    """One fault with its values.

    Attributes:
        name: name of the fault.
        scope: ``joint`` or ``arm``.
        looks_like: what gives it away in data.
    """

    name: ClassVar[str]
    scope: ClassVar[str]
    looks_like: ClassVar[str]

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


def _scaled(recording: Recording, channels: tuple[str, ...], columns: np.ndarray, factor: float) -> Recording:
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
        channel: ``joint`` for position and torque, ``position`` or ``torque`` alone.
    """

    name = "sign_flip"
    scope = "joint"
    looks_like = "torque of a joint mirrored against what its motion needs"
    joints: tuple[int, ...]
    channel: str = "torque"

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Turn the sign of the channels round."""
        channels = {"joint": POSITIONS + TORQUES, "position": POSITIONS, "torque": TORQUES}
        if self.channel not in channels:
            raise InputError(f"unknown channel {self.channel!r}", f"use {', '.join(channels)}", where=self.name)
        return _scaled(recording, channels[self.channel], _columns(recording, self.joints, self.name), -1.0)


@dataclass(frozen=True)
class JointSwap(Fault):
    """The columns of two joints exchanged.

    Attributes:
        joints: the two, from 1.
        channel: ``joint`` for all channels, ``torque`` for those of torque.
    """

    name = "joint_swap"
    scope = "joint"
    looks_like = "each of two torques fits the other joint's motion"
    joints: tuple[int, int]
    channel: str = "torque"

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Exchange the columns."""
        first, second = _columns(recording, self.joints, self.name)
        channels = CHANNELS if self.channel == "joint" else TORQUES
        changed: dict[str, Any] = {}
        for channel in channels:
            series = getattr(recording, channel)
            if series is not None:
                changed[channel] = np.array(series)
                changed[channel][:, [first, second]] = changed[channel][:, [second, first]]
        return replace(recording, **changed)


@dataclass(frozen=True)
class UnitMismatch(Fault):
    """A channel in another unit than it is taken for.

    Attributes:
        unit: ``degrees`` (positions), ``milliseconds`` (time) or ``motor_side`` (position times, torque over, ratio).
        joints: from 1; all where empty. Of no meaning for milliseconds.
        ratio: gear ratio of ``motor_side`` [1].
    """

    name = "unit_mismatch"
    scope = "joint"
    looks_like = "positions, times or torques off by a factor that is a unit's or a gear's"
    unit: str
    joints: tuple[int, ...] = ()
    ratio: float = 100.0

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Write the channel in the other unit."""
        joints = self.joints or tuple(range(1, recording.n_joints + 1))
        columns = _columns(recording, joints, self.name)
        if self.unit == "degrees":
            return _scaled(recording, POSITIONS, columns, 180.0 / np.pi)
        if self.unit == "milliseconds":
            return replace(recording, t=1e3 * recording.t)
        if self.unit == "motor_side":
            turned = _scaled(recording, POSITIONS, columns, self.ratio)
            return _scaled(turned, TORQUES, columns, 1.0 / self.ratio)
        raise InputError(f"unknown unit {self.unit!r}", "use degrees, milliseconds or motor_side", where=self.name)


@dataclass(frozen=True)
class TimeStamps(Fault):
    """Time stamps that are not those of the samples.

    Attributes:
        kind: ``gaps`` (stretches lost), ``repeats`` (samples written twice), ``jitter`` (stamps off at random) or
            ``wrong_rate`` (stamps made from an assumed rate).
        amount: share of the samples lost or repeated, jitter over the period, or assumed over true period [1].
    """

    name = "time_stamps"
    scope = "arm"
    looks_like = "steps of time that differ, or torque that fits accelerations of another time scale"
    kind: str
    amount: float

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Lose, repeat or shift stamps."""
        t, count = recording.t, len(recording.t)
        if self.kind == "wrong_rate":
            return replace(recording, t=t[0] + (t - t[0]) * self.amount)
        if self.kind == "jitter":
            period = float(np.median(np.diff(t)))
            shifts = np.clip(self.amount * rng.standard_normal(count), -0.45, 0.45)
            return replace(recording, t=t + period * shifts)
        if self.kind == "gaps":
            length = max(1, int(self.amount * count / 3))
            lost = np.concatenate([np.arange(s, s + length) for s in rng.integers(1, count - length, 3)])
            return _rows(recording, np.setdiff1d(np.arange(count), lost))
        if self.kind == "repeats":
            twice = rng.choice(np.arange(1, count), size=max(1, int(self.amount * count)), replace=False)
            rows = np.arange(count)
            rows[twice] -= 1  # the sample before is written once more, under a new stamp
            return replace(_rows(recording, rows), t=t)
        raise InputError(f"unknown kind {self.kind!r}", "use gaps, repeats, jitter or wrong_rate", where=self.name)


def _rows(recording: Recording, rows: np.ndarray) -> Recording:
    channels: dict[str, Any] = {name: getattr(recording, name) for name in ("t", *CHANNELS)}
    return replace(recording, **{name: series[rows] for name, series in channels.items() if series is not None})


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
    by: int = 1
    moved_only: bool = False

    def apply(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording, which is right; see ``urdf``."""
        return recording

    def urdf(self, text: str) -> str:
        """URDF text with the ``<inertial>`` of each link that has one moved to the next such link, in file order."""
        root = ET.fromstring(text)
        moving = [joint for joint in root.iter("joint") if joint.get("type") in ("revolute", "continuous", "prismatic")]
        turned = {child.get("link") for joint in moving for child in joint.iter("child")}
        links = [
            link for link in root.iter("link")
            if link.find("inertial") is not None and (not self.moved_only or link.get("name") in turned)
        ]  # fmt: skip
        inertials = [link.find("inertial") for link in links]
        for link, own, given in zip(links, inertials, np.roll(np.arange(len(links)), self.by), strict=True):
            assert own is not None
            link.remove(own)
            moved = inertials[int(given)]
            assert moved is not None
            link.append(moved)
        return ET.tostring(root, encoding="unicode")


FAULTS: dict[str, type[Fault]] = {
    fault.name: fault for fault in (SignFlip, JointSwap, UnitMismatch, ShiftedInertials, TimeStamps)
}
"""The setup faults by name."""


def parameters(fault: Fault) -> dict[str, object]:
    """The values of a fault by name, for a label."""
    return {field.name: getattr(fault, field.name) for field in fields(fault)}
