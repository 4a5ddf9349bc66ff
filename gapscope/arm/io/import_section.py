"""The ``import:`` section of a case: how logs in foreign columns, units and on the motor's side become recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.transmission import parse_transmission, per_joint
from gapscope.arm.recording import CHANNELS

UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "rad": 1.0,
    "deg": np.pi / 180,
    "rev": 2 * np.pi,
    "rad/s": 1.0,
    "deg/s": np.pi / 180,
    "rpm": 2 * np.pi / 60,
    "N m": 1.0,
    "mN m": 1e-3,
    "N cm": 1e-2,
    "degC": 1.0,
}
"""Factor from a unit to the one that a recording holds."""

_MOTOR_MOTION = ("q", "dq", "q_ref", "dq_ref")


@dataclass(frozen=True)
class Channel:
    """Where a log holds one channel.

    Attributes:
        column: pattern of the column names, in which ``{j}`` is the joint's number from 1, ``{j0}`` for that
            from 0 and ``{joint}`` for its name; or one name per joint; a pattern without any of these names one
            column whose cells hold lists.
        factor: from the column's unit to the recording's, times the scale; a number or one per joint, (n,).
        file: label of the file that holds it, if several lie side by side.
        named: whether the import section names it, so that a case's recordings have to hold it.
    """

    column: str | tuple[str, ...]
    factor: float | np.ndarray = 1.0
    file: str | None = None
    named: bool = False

    def names(self, joints: Sequence[str]) -> list[str]:
        """Names of the columns: one per joint, or a single one whose cells hold lists."""
        if isinstance(self.column, tuple):
            return list(self.column)
        names = [self.name_of(j, joint) for j, joint in enumerate(joints)]
        return names if "{" in self.column else [self.column]

    def name_of(self, j: int, joint: str) -> str:
        """Name of the column of joint ``j``, from 0, by the pattern."""
        return (
            str(self.column)
            .replace("{joint}", joint)
            .replace("{j}", str(j + 1))
            .replace("{j0}", str(j))
        )


@dataclass(frozen=True)
class TimeColumn:
    """Where a log holds the time.

    Attributes:
        column: name of the column, or ``None`` if there is none and ``rate`` alone gives the time.
        factor: from the column's unit to s.
        rate: samples per second [Hz], if the column counts samples or there is none.
    """

    column: str | None = "t"
    factor: float = 1.0
    rate: float | None = None


@dataclass(frozen=True)
class Import:
    """How to read logs that are not in the columns of the case format, for an arm of n joints.

    The raw value of each column is turned into the recording's in this order: times the channel's unit and scale;
    through the transmission; times the joint's sign (motion and torque alike); plus the joint's offset (positions).

    The transmission is the matrix R of q_motor = R q_joint, shape (n, n) [1]. So q_joint = R^-1 q_motor, likewise
    for velocities and references, and, as power is the same on both sides, tau_joint = R^T tau_motor. Its entry
    R[m, j] is the number of turns of motor m for one turn of joint j: gear ratios on the diagonal, couplings beside it.

    Attributes:
        time: where the time stands.
        channels: where each channel stands; ``None`` for one that is not to be read.
        joints: names of the joints in the log, in the arm's order (ROS 2 bags).
        topic: topic of the joint states (ROS 2 bags).
        signs: +1 or -1 per joint, (n,), or ``None``.
        offsets: added to the positions [rad], (n,), or ``None``.
        transmission: R, or ``None`` if the log is on the joint's side.
        join: how rows of files side by side meet: ``row`` by row, or by time onto the file that holds q:
            ``interpolate`` or ``hold`` (the last value before).
        fit, judge: row ranges of each file, both ends included, counted from 0 below the header; ``fit`` empty: all.
        source: the case file, for messages.
    """

    time: TimeColumn = TimeColumn()
    channels: Mapping[str, Channel | None] = field(
        default_factory=lambda: {name: Channel(name + "{j}") for name in CHANNELS}
    )
    joints: tuple[str, ...] | None = None
    topic: str | None = None
    signs: np.ndarray | None = None
    offsets: np.ndarray | None = None
    transmission: np.ndarray | None = None
    join: str = "row"
    fit: tuple[tuple[int, int], ...] = ()
    judge: tuple[tuple[int, int], ...] = ()
    source: Path | None = None

    @property
    def main_file(self) -> str | None:
        """Label of the file that holds q and whose time counts."""
        q = self.channels["q"]
        return q.file if q is not None else None

    def to_joint_side(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Channels, (N, n) each, through transmission (but for tau_sensor and temperature), signs and offsets."""
        out = dict(values)
        if self.transmission is not None:
            inverse = np.linalg.inv(self.transmission)
            for name in _MOTOR_MOTION:
                if name in out:
                    out[name] = out[name] @ inverse.T
            if "tau" in out:
                out["tau"] = out["tau"] @ self.transmission
        if self.signs is not None:
            out = {
                name: x if name == "temperature" else x * self.signs
                for name, x in out.items()
            }
        if self.offsets is not None:
            out |= {
                name: out[name] + self.offsets for name in ("q", "q_ref") if name in out
            }
        return out


def parse_import(section: Mapping[str, Any], n_joints: int, source: Path) -> Import:
    """Import section of a case that has passed the case schema.

    Args:
        section: the content of ``import:``.
        n_joints: number of joints n.
        source: the case file, for messages.

    Raises:
        InputError: a list has not one value per joint, the transmission cannot be inverted, or keys contradict.
    """
    given = {key: section[key] for key in ("topic", "join") if key in section}
    for key in ("signs", "offsets"):
        if key in section:
            given[key] = per_joint(section[key], n_joints, source, key)
    if "joints" in section:
        given["joints"] = tuple(
            per_joint(section["joints"], n_joints, source, "joints", str)
        )
    if "transmission" in section:
        given["transmission"] = parse_transmission(
            section["transmission"], n_joints, source
        )
    if "rows" in section:
        given |= {
            key: _ranges(ranges, source, key) for key, ranges in section["rows"].items()
        }
    channels = {
        name: _channel(name, section[name], n_joints, source)
        if name in section
        else Channel(name + "{j}")
        for name in CHANNELS
    }
    if channels["q"] is None:
        raise InputError(
            "is null, but a recording needs positions",
            file=source,
            where="field import.q",
        )
    return Import(
        time=_time(section.get("time", {"column": "t"}), source),
        channels=channels,
        source=source,
        **given,
    )


def _time(entry: str | Mapping[str, Any], source: Path) -> TimeColumn:
    if isinstance(entry, str):
        return TimeColumn(entry)
    if "rate" in entry and "unit" in entry:
        raise InputError(
            "has a unit and a rate",
            "give the unit of a time, or the rate of a count",
            file=source,
            where="field import.time",
        )
    if "rate" in entry:
        return TimeColumn(entry.get("column"), rate=float(entry["rate"]))
    return TimeColumn(entry.get("column", "t"), UNITS[entry.get("unit", "s")])


def _channel(name: str, entry: Any, n_joints: int, source: Path) -> Channel | None:
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        entry = {"column": entry}
    column = entry.get("column", name + "{j}")
    if isinstance(column, list):
        column = tuple(per_joint(column, n_joints, source, f"{name}.column", str))
    factor: Any = entry.get("scale", 1.0)
    if isinstance(factor, list):
        factor = per_joint(factor, n_joints, source, f"{name}.scale")
    return Channel(
        column,
        factor * UNITS[entry["unit"]] if "unit" in entry else factor,
        entry.get("file"),
        named=True,
    )


def _ranges(entry: list[Any], source: Path, key: str) -> tuple[tuple[int, int], ...]:
    """``[first, last]`` or a list of those."""
    pairs = [entry] if isinstance(entry[0], int) else entry
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or pair[0] > pair[1]:
            raise InputError(
                f"expected [first, last] or a list of those, got {entry}",
                file=source,
                where=f"field import.rows.{key}",
            )
    return tuple((int(first), int(last)) for first, last in pairs)
