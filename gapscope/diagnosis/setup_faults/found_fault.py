"""A setup fault that was found, and how to put it right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.controller import Controller
from gapscope.arm.io.plausibility import repeated_rows
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.arm.torque_column import advanced, with_gravity
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.clock import even_stamps
from gapscope.diagnosis.setup_faults.references.repair import reference_repaired
from gapscope.diagnosis.setup_faults.shifted_inertials import shifted_arm

MOTION = ("q", "dq", "q_ref", "dq_ref")
TORQUE = ("tau", "tau_sensor")
OF_TAU_ALONE = ("torque_unit", "late_torque", "gravity_compensated_torque")
"""Faults that joint torque sensors do not have."""


@dataclass(frozen=True)
class FaultParameter:
    """A parameter with its uncertainty.

    Attributes:
        unit: SI unit, 1 if there is none.
        value: one number per joint of the fault, or one for the arm.
        std: standard deviation of each, or ``None`` if the value is a choice among few.
    """

    unit: str
    value: tuple[float, ...]
    std: tuple[float, ...] | None = None


@dataclass(frozen=True)
class FoundFault:
    """A setup fault, or what else shows in the recordings themselves, n joints.

    Attributes:
        name: name of the fault, or ``encoder_quantization``.
        joints: from 1; empty if it concerns the whole arm.
        variant: which channel (``torque``, ``position``, ``joint``), unit (``degrees``, ``revolutions``,
            ``milliseconds``, ``motor_side``, ``current``, ``command_scale``) or kind (``gaps``, ``repeats``,
            ``jitter``, ``wrong_rate``, ``torque_clock``, ``delay``, ``held``, ``interpolated``); empty if only one.
        parameters: by the names of ``gapscope.effects.setup_faults``.
        probability: that it is this fault.
        turned_base: probability that the base is turned instead, ``base_tilt``; ``None`` if that looks different.
        recordings: names of the recordings that have it; empty: all.
        mapping: how its recordings must be read; ``None`` if it asks for no other mapping.
        gap_with_only_this, gap_without_this: torque NRMSE, (n,), with this fault alone corrected, and with all others
            but this; ``None`` if it cannot be computed.
        gap_before, gap_after: torque NRMSE, (n,), of the case as it is, and with all faults corrected.
    """

    name: str
    joints: tuple[int, ...]
    variant: str
    parameters: Mapping[str, FaultParameter]
    probability: float
    recordings: tuple[str, ...] = ()
    mapping: ChannelMapping | None = None
    turned_base: float | None = None
    gap_with_only_this: np.ndarray | None = field(default=None, repr=False)
    gap_without_this: np.ndarray | None = field(default=None, repr=False)
    gap_before: np.ndarray | None = field(default=None, repr=False)
    gap_after: np.ndarray | None = field(default=None, repr=False)

    def repair(self, recording: Recording) -> Recording:
        """The recording as a right set-up would have written it, with a note; unchanged if it does not have it.

        Gravity that was left out of its torque stays out: see ``repaired``.
        """
        if self.recordings and recording.name not in self.recordings:
            return recording
        out = recording
        if self.mapping is not None:
            torques = ("tau",) if self.name in OF_TAU_ALONE else TORQUE
            out = _mapped(out, self.mapping, torques)
        values = {name: p.value for name, p in self.parameters.items()}
        out = reference_repaired(self.name, self.joints, values, out)
        if self.variant == "jitter":
            out = replace(out, t=even_stamps(out.t))
        if self.variant == "repeats":
            out = _without_repeats(out)
        if self.variant == "torque_clock":
            out = advanced(out, 0.0, values["amount"][0] - 1.0)
        if out is recording:
            return recording
        return replace(out, notes=(*out.notes, f"put right: {self}"))

    def repair_arm(self, arm: NominalArm) -> NominalArm:
        """The nominal arm with its inertials where they belong; unchanged for other faults."""
        if self.mapping is None:
            return arm
        return shifted_arm(arm, self.mapping.link_shift, self.mapping.moved_only)

    def repair_controller(self, controller: Controller | None) -> Controller | None:
        """The controller with the gains at work in place of the declared ones; unchanged for other faults."""
        if self.name != "gain_mismatch" or not isinstance(controller, PD):
            return controller
        columns = np.array(self.joints) - 1
        kp, kd = np.array(controller.kp), np.array(controller.kd)
        kp[columns] *= self.parameters["kp_factor"].value
        kd[columns] *= self.parameters["kd_factor"].value
        return replace(controller, kp=kp, kd=kd)

    def document(self) -> dict[str, Any]:
        """The parameters as ``diagnosis.json`` holds them, and the variant."""
        parameters = {}
        for name, parameter in self.parameters.items():
            value: Any = list(parameter.value)
            std: Any = None if parameter.std is None else list(parameter.std)
            if not self.joints:  # one value for the arm
                value, std = value[0], std[0] if std else None
            parameters[name] = {"unit": parameter.unit, "value": value, "std": std}
        content: dict[str, Any] = {"parameters": parameters}
        if self.variant:
            content["variant"] = self.variant
        return content

    def __str__(self) -> str:
        """In words."""
        variant = f" ({self.variant})" if self.variant else ""
        joints = f", joint {', '.join(map(str, self.joints))}" if self.joints else ""
        return f"{self.name}{variant}{joints}"


def repaired(case: Case, faults: tuple[FoundFault, ...]) -> Case:
    """The case with all faults corrected, in the order in which they were found."""
    arm, recordings, judged = case.arm, case.recordings, case.judged
    controller = case.controller
    for fault in faults:
        arm = fault.repair_arm(arm)
        controller = fault.repair_controller(controller)
        recordings = tuple(fault.repair(r) for r in recordings)
        judged = tuple(fault.repair(r) for r in judged)
        if controller is not None and "kp_at_work" in fault.parameters:
            # the declared controller gives the torque that was not measured
            recordings = tuple(replace(r, tau=None) for r in recordings)
            judged = tuple(replace(r, tau=None) for r in judged)
        if fault.mapping is not None and fault.mapping.without_gravity:
            recordings = tuple(with_gravity(r, arm) for r in recordings)
            judged = tuple(with_gravity(r, arm) for r in judged)
    return replace(
        case, arm=arm, recordings=recordings, judged=judged, controller=controller
    )


def _mapped(
    recording: Recording, mapping: ChannelMapping, torques: tuple[str, ...]
) -> Recording:
    """Columns, units and stamps of a recording corrected, and the delay of its torque.

    Recorded velocities do not depend on the stamps. ``torques`` are the channels whose torque is at fault.
    """
    motion, torque = list(mapping.motion_source), list(mapping.torque_source)
    changed: dict[str, Any] = {}
    for channel, series in present_channels(recording).items():
        if channel in MOTION:
            changed[channel] = series[:, motion] * np.array(mapping.motion_factor)
            if channel in ("q", "q_ref"):
                changed[channel] += np.array(mapping.motion_offset)
        elif channel in torques:
            changed[channel] = series[:, torque] * np.array(mapping.torque_factor)
        else:
            changed[channel] = series[:, motion]
    if mapping.time_factor != 1.0:
        start = recording.t[0]
        changed["t"] = start + (recording.t - start) * mapping.time_factor
    return advanced(replace(recording, **changed), mapping.torque_delay)


def _without_repeats(recording: Recording) -> Recording:
    """The recording without rows that repeat the measurement before them."""
    present = present_channels(recording)
    repeated, notes = repeated_rows(recording.t, present)
    if not repeated.any():
        return recording
    kept: dict[str, Any] = {name: x[~repeated] for name, x in present.items()}
    return replace(
        recording, t=recording.t[~repeated], notes=recording.notes + notes, **kept
    )


def present_channels(recording: Recording) -> dict[str, np.ndarray]:
    """The channels that a recording has, by name, (N, n) each."""
    channels = {name: getattr(recording, name) for name in CHANNELS}
    return {name: series for name, series in channels.items() if series is not None}
