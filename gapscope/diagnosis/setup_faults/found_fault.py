"""A setup fault that was found, and how to put it right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.effects.setup_faults.fault import Fault


@dataclass(frozen=True)
class FoundFault:
    """A setup fault, or what else shows in the recordings themselves, n joints.

    Attributes:
        fault: the fault with its values.
        probability: that it is this fault.
        std: standard deviation of each value of a parameter, by its name; without it the value is a choice among few.
        recordings: names of the recordings that have it; empty: all.
        turned_base: probability that the base is turned instead, ``base_tilt``; ``None`` if that looks different.
        gap_with_only_this, gap_without_this: torque NRMSE, (n,), with this fault alone corrected, and with all others
            but this; ``None`` if it cannot be computed.
        gap_before, gap_after: torque NRMSE, (n,), of the case as it is, and with all faults corrected.
    """

    fault: Fault
    probability: float
    std: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    recordings: tuple[str, ...] = ()
    turned_base: float | None = None
    gap_with_only_this: np.ndarray | None = field(default=None, repr=False)
    gap_without_this: np.ndarray | None = field(default=None, repr=False)
    gap_before: np.ndarray | None = field(default=None, repr=False)
    gap_after: np.ndarray | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of the fault, or ``encoder_quantization``."""
        return self.fault.name

    @property
    def variant(self) -> str:
        """Which channel, unit or kind; empty if there is one only."""
        return self.fault.kind[1]

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1; empty if it concerns the whole arm."""
        return self.fault.kind[2]

    def reading(self, n: int) -> Reading:
        """How its recordings must be read, of n joints; time by files, each as a whole."""
        reading = self.fault.reading(n)
        if not reading.differs("time_factor"):
            return reading
        names = (name.partition(" rows ")[0] for name in self.recordings)
        files = dict.fromkeys(name.partition(" episode ")[0] for name in names)
        return replace(reading, files=tuple(files))

    def repair(self, recording: Recording, arm: NominalArm | None = None) -> Recording:
        """The recording as a right set-up would have written it, with a note; unchanged if it does not have it.

        Args:
            recording: as it was read.
            arm: the nominal arm, if gravity may have been left out of the torque.
        """
        if self.recordings and recording.name not in self.recordings:
            return recording
        reading = self.fault.reading(recording.n_joints)
        out = reading(recording, arm)
        if out is recording and not reading.link_shift:
            return recording
        return replace(out, notes=(*out.notes, f"put right: {self}"))

    def document(self) -> dict[str, Any]:
        """The parameters as ``diagnosis.json`` holds them, and the variant."""
        units = {parameter.name: parameter.unit for parameter in self.fault.parameters}
        parameters = {}
        for name, values in self.fault.values().items():
            stds = self.std.get(name)
            value: Any = list(values)
            std: Any = None if stds is None else list(stds)
            if not self.joints:  # one value for the arm
                value, std = value[0], std[0] if std else None
            parameters[name] = {"unit": units[name], "value": value, "std": std}
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
        reading = fault.reading(arm.n_joints)
        arm, controller = reading.arm(arm), reading.controller(controller)
        recordings = tuple(fault.repair(r, arm) for r in recordings)
        judged = tuple(fault.repair(r, arm) for r in judged)
        if controller is not None and reading.law:
            # the declared controller gives the torque that was not measured
            recordings = tuple(replace(r, tau=None) for r in recordings)
            judged = tuple(replace(r, tau=None) for r in judged)
    return replace(
        case, arm=arm, recordings=recordings, judged=judged, controller=controller
    )
