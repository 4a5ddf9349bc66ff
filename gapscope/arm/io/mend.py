"""The ``mend:`` part of an import section: what is wrong with logs beyond their columns and units, put right last.

A diagnosis that finds set-up faults writes it, whatever the format of the log and the rest of its import section.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.reference_column import at_pace, without_lead
from gapscope.arm.torque_column import advanced, with_gravity

MOTION = ("q", "dq", "q_ref", "dq_ref")
"""Channels that ``motion`` changes; an offset goes to positions alone."""


@dataclass(frozen=True)
class ColumnChange:
    """Series of n joints out of those that were read: x_j = scale_j read x_columns_j + offset_j.

    Attributes:
        columns: joint, from 0, whose column holds this joint, (n,).
        scale: [1], (n,).
        offset: of positions [rad], (n,).
    """

    columns: np.ndarray
    scale: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(
        cls, entry: Mapping[str, Any], n_joints: int, source: Path, key: str
    ) -> ColumnChange:
        """From an entry of ``mend:``; raises ``InputError`` if it does not have one value per joint."""

        def per_joint(name: str, default: float | range) -> np.ndarray:
            values = np.array(entry.get(name, default), dtype=float)
            if values.ndim == 0:
                values = np.full(n_joints, values)
            if values.shape != (n_joints,):
                raise InputError(
                    f"expected {n_joints} entries, one per joint, got {values.size}",
                    file=source,
                    where=f"field import.mend.{key}.{name}",
                )
            return values

        columns = per_joint("columns", range(1, n_joints + 1)).astype(int) - 1
        if sorted(columns) != list(range(n_joints)):
            raise InputError(
                f"expected each of the numbers 1 to {n_joints} once, got {entry['columns']}",
                "give for each joint the number of the joint whose column holds it",
                file=source,
                where=f"field import.mend.{key}.columns",
            )
        return cls(columns, per_joint("scale", 1.0), per_joint("offset", 0.0))

    def __call__(self, series: np.ndarray, *, position: bool = False) -> np.ndarray:
        """The series of the joints, (N, n)."""
        out = series[:, self.columns] * self.scale
        return out + self.offset if position else out


@dataclass(frozen=True)
class Mend:
    """What is put right after everything else in an import section.

    Attributes:
        motion: of q, dq, q_ref and dq_ref; temperatures follow its columns. ``None``: they are right.
        torque: of tau.
        sensor: of tau_sensor.
        delay: by which tau is late against the motion [s].
        without_gravity: whether the nominal arm's gravity torque was left out of tau.
        lead: kd / kp of a controller that ignores the velocity's reference [s]; 0: it does not.
        pace: the arm's speed over that of the reference [1].
        time_scale: true over recorded period [1], ...
        files: ...of the files of these names; of all if empty.
    """

    motion: ColumnChange | None = None
    torque: ColumnChange | None = None
    sensor: ColumnChange | None = None
    delay: float = 0.0
    without_gravity: bool = False
    lead: float = 0.0
    pace: float = 1.0
    time_scale: float = 1.0
    files: tuple[str, ...] = ()

    def true_time(self, t: np.ndarray, file: str) -> np.ndarray:
        """Time of a file's rows [s], (N,), of the recorded one."""
        if self.files and file not in self.files:
            return t
        return t * self.time_scale

    def __call__(self, recording: Recording, arm: NominalArm) -> Recording:
        """A recording whose time is right, put right.

        Args:
            recording: as the rest of the import section gives it, with its known load.
            arm: the nominal arm, whose gravity torque is added.
        """
        changed: dict[str, np.ndarray] = {}
        for name in MOTION:
            series = getattr(recording, name)
            if series is not None and self.motion is not None:
                position = name in ("q", "q_ref")
                changed[name] = self.motion(series, position=position)
        if recording.temperature is not None and self.motion is not None:
            changed["temperature"] = recording.temperature[:, self.motion.columns]
        for name, change in (("tau", self.torque), ("tau_sensor", self.sensor)):
            series = getattr(recording, name)
            if series is not None and change is not None:
                changed[name] = change(series)
        out = replace(recording, **changed)  # type: ignore[arg-type]
        out = at_pace(without_lead(out, self.lead), self.pace)
        out = advanced(out, self.delay)
        return with_gravity(out, arm) if self.without_gravity else out

    @property
    def of_every_row(self) -> Mend:
        """The same without what leaves rows out: a late torque, and a reference that ended."""
        return replace(self, delay=0.0, pace=1.0)


def parse_mend(section: Mapping[str, Any], n_joints: int, source: Path) -> Mend:
    """The ``mend:`` part of an import section that has passed the case schema.

    Raises:
        InputError: a list has not one value per joint, or columns are no order of the joints.
    """
    changes = {
        key: ColumnChange.of(section[key], n_joints, source, key)
        for key in ("motion", "torque", "sensor")
        if key in section
    }
    torque, time = section.get("torque", {}), section.get("time", {})
    reference = section.get("reference", {})
    return Mend(
        **changes,
        delay=float(torque.get("delay", 0.0)),
        without_gravity=torque.get("gravity") == "left_out",
        lead=float(reference.get("lead", 0.0)),
        pace=float(reference.get("pace", 1.0)),
        time_scale=float(time.get("scale", 1.0)),
        files=tuple(time.get("files", ())),
    )
