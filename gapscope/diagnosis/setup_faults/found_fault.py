"""A setup fault that was found, and how to put it right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.io.plausibility import repeated_rows
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.clock import even_stamps
from gapscope.diagnosis.setup_faults.shifted_inertials import shifted_arm

MOTION = ("q", "dq", "q_ref", "dq_ref")
TORQUE = ("tau", "tau_sensor")


@dataclass(frozen=True)
class Quantity:
    """A parameter with its uncertainty.

    Attributes:
        unit: SI unit, 1 where there is none.
        value: one number per joint of the fault, or one for the arm.
        std: standard deviation of each, or ``None`` where the value is a choice among few.
    """

    unit: str
    value: tuple[float, ...]
    std: tuple[float, ...] | None = None


@dataclass(frozen=True)
class FoundFault:
    """A setup fault, or what else shows in the recordings themselves, n joints.

    Attributes:
        name: name of the fault, or ``encoder_quantization``.
        joints: from 1; empty where it concerns the whole arm.
        variant: which channel (``torque``, ``position``, ``joint``), unit (``degrees``, ``milliseconds``,
            ``motor_side``) or kind (``gaps``, ``repeats``, ``jitter``, ``wrong_rate``); empty where there is one only.
        parameters: by the names of ``gapscope.effects.setup_faults``.
        probability: that it is this fault.
        recordings: names of the recordings that have it; empty: all.
        reading: how its recordings have to be read; ``None`` where nothing is to be put right by it.
        gap_with_only_this, gap_without_this: torque NRMSE, (n,), with this fault alone put right, and with all others
            but this; ``None`` where it cannot be computed.
        gap_before, gap_after: torque NRMSE, (n,), of the case as it is, and with all faults put right.
    """

    name: str
    joints: tuple[int, ...]
    variant: str
    parameters: Mapping[str, Quantity]
    probability: float
    recordings: tuple[str, ...] = ()
    reading: ChannelMapping | None = None
    gap_with_only_this: np.ndarray | None = field(default=None, repr=False)
    gap_without_this: np.ndarray | None = field(default=None, repr=False)
    gap_before: np.ndarray | None = field(default=None, repr=False)
    gap_after: np.ndarray | None = field(default=None, repr=False)

    def repair(self, recording: Recording) -> Recording:
        """The recording as a right set-up would have written it, with a note; unchanged where it does not have it."""
        if self.recordings and recording.name not in self.recordings:
            return recording
        out = _read(recording, self.reading) if self.reading is not None else recording
        if self.variant == "jitter":
            out = replace(out, t=even_stamps(out.t))
        if self.variant == "repeats":
            out = _without_repeats(out)
        return (
            out
            if out is recording
            else replace(out, notes=(*out.notes, f"put right: {self}"))
        )

    def repair_arm(self, arm: NominalArm) -> NominalArm:
        """The nominal arm with its inertials where they belong; unchanged for other faults."""
        return (
            shifted_arm(arm, self.reading.shift, self.reading.moved_only)
            if self.reading is not None
            else arm
        )

    def document(self) -> dict[str, Any]:
        """The parameters as ``diagnosis.json`` holds them, and the variant."""
        parameters = {}
        for name, q in self.parameters.items():
            alone = not self.joints
            value: Any = q.value[0] if alone else list(q.value)
            std: Any = None if q.std is None else q.std[0] if alone else list(q.std)
            parameters[name] = {"unit": q.unit, "value": value, "std": std}
        return {
            "parameters": parameters,
            **({"variant": self.variant} if self.variant else {}),
        }

    def __str__(self) -> str:
        """In words."""
        joints = f", joint {', '.join(map(str, self.joints))}" if self.joints else ""
        return f"{self.name}{f' ({self.variant})' if self.variant else ''}{joints}"


def repaired(case: Case, faults: tuple[FoundFault, ...]) -> Case:
    """The case with all faults put right, in the order in which they were found."""
    arm, recordings, judged = case.arm, case.recordings, case.judged
    for fault in faults:
        arm = fault.repair_arm(arm)
        recordings = tuple(fault.repair(r) for r in recordings)
        judged = tuple(fault.repair(r) for r in judged)
    return replace(case, arm=arm, recordings=recordings, judged=judged)


def _read(recording: Recording, reading: ChannelMapping) -> Recording:
    """Columns, units and stamps of a recording put right; recorded velocities do not depend on the stamps."""
    changed: dict[str, Any] = {}
    motion, torque = list(reading.motion_source), list(reading.torque_source)
    for channel in CHANNELS:
        series = getattr(recording, channel)
        if series is None:
            continue
        if channel in MOTION:
            changed[channel] = series[:, motion] * np.array(reading.motion_factor)
        elif channel in TORQUE:
            changed[channel] = series[:, torque] * np.array(reading.torque_factor)
        else:
            changed[channel] = series[:, motion]
    if reading.time_factor != 1.0:
        changed["t"] = (
            recording.t[0] + (recording.t - recording.t[0]) * reading.time_factor
        )
    return replace(recording, **changed)


def _without_repeats(recording: Recording) -> Recording:
    """The recording without rows that repeat the measurement before them."""
    present = {
        name: x for name in CHANNELS if (x := getattr(recording, name)) is not None
    }
    repeated, notes = repeated_rows(recording.t, present)
    if not repeated.any():
        return recording
    kept: dict[str, Any] = {name: x[~repeated] for name, x in present.items()}
    return replace(
        recording, t=recording.t[~repeated], notes=recording.notes + notes, **kept
    )
