"""The ``import:`` section of a case: how logs in foreign columns, units and on the motor's side become recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.channel_entry import (
    UNITS,
    Channel,
    MotorRange,
    parse_channel,
    parse_transmission,
    per_joint,
    read_calibration,
)
from gapscope.arm.reading import Columns, Reading
from gapscope.arm.recording import CHANNELS

_MOTOR_MOTION = ("q", "dq", "q_ref", "dq_ref")


@dataclass(frozen=True)
class TimeColumn:
    """Where a log holds the time.

    Attributes:
        column: name of the column or its number from 1, or ``None`` if there is none and ``rate`` alone gives the time.
        factor: from the column's unit to s.
        rate: samples per second [Hz], if the column counts samples or there is none.
        file: label of the file that holds it, row by row, if it is not that of the positions.
    """

    column: str | None = "t"
    factor: float = 1.0
    rate: float | None = None
    file: str | None = None


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
        joints: names of the joints in the log, in the arm's order; by default the arm's own.
        topic: topic or table that holds q, in a log of several.
        transmission: R, or ``None`` if the log is on the joint's side.
        turned: signs and offsets of the joints behind it; ``None`` if there are none.
        join: how rows of files or topics side by side meet: ``row`` by row, or by time onto the one that holds q:
            ``interpolate`` or ``hold`` (the last value before); ``None``: topics by interpolation, files by row.
        fit, judge: row ranges of each file, both ends included, counted from 0 below the header; ``fit`` empty: all.
        fit_episodes, judge_episodes: episodes of each dataset; both empty: all are fitted.
        calibration: of the motors, by name, for positions in normalised units; ``None`` if there is none.
        mend: what is put right after all this; ``None``: nothing.
        source: the case file, for messages.
    """

    time: TimeColumn = TimeColumn()
    channels: Mapping[str, Channel | None] = field(
        default_factory=lambda: {name: Channel(name + "{j}") for name in CHANNELS}
    )
    joints: tuple[str, ...] | None = None
    topic: str | None = None
    transmission: np.ndarray | None = None
    turned: Reading | None = None
    join: str | None = None
    fit: tuple[tuple[int, int], ...] = ()
    judge: tuple[tuple[int, int], ...] = ()
    fit_episodes: tuple[int, ...] = ()
    judge_episodes: tuple[int, ...] = ()
    calibration: Mapping[str, MotorRange] | None = None
    mend: Reading | None = None
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
        return out if self.turned is None else out | self.turned.of_channels(out)


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
    if "signs" in section or "offsets" in section:
        given["turned"] = _turned(section, n_joints, source)
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
    for key, episodes in section.get("episodes", {}).items():
        given[f"{key}_episodes"] = tuple(episodes)
    if "calibration" in section:
        given["calibration"] = read_calibration(source.parent / section["calibration"])
    if "mend" in section:
        given["mend"] = Reading.from_mend(section["mend"] or {}, n_joints, source)
    channels = {
        name: parse_channel(name, section[name], n_joints, source)
        if name in section
        else Channel(name + "{j}")
        for name in CHANNELS
    }
    _check_sides(section, source)
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


def _turned(section: Mapping[str, Any], n_joints: int, source: Path) -> Reading:
    """Signs and offsets of an import section."""
    same = Columns.identity(n_joints)
    signs = per_joint(section.get("signs", same.factor), n_joints, source, "signs")
    offsets = section.get("offsets", same.offset)
    added = per_joint(offsets, n_joints, source, "offsets")
    torque = replace(same, factor=tuple(signs.tolist()))
    motion = replace(torque, offset=tuple(added.tolist()))
    return Reading.identity(n_joints, motion=motion, torque=torque, sensor=torque)


def _check_sides(section: Mapping[str, Any], source: Path) -> None:
    """A gear ratio is given once: for the current, or in the transmission of all channels."""
    entry = section.get("tau")
    if (
        isinstance(entry, Mapping)
        and "gear_ratio" in entry
        and "transmission" in section
    ):
        raise InputError(
            "has a gear_ratio beside the transmission, which takes the torque to the joint's side already",
            "give the ratio in one of them",
            file=source,
            where="field import.tau.gear_ratio",
        )


def _time(entry: str | int | Mapping[str, Any], source: Path) -> TimeColumn:
    if not isinstance(entry, Mapping):
        return TimeColumn(str(entry))
    file = entry.get("file")
    if "rate" in entry and "unit" in entry:
        raise InputError(
            "has a unit and a rate",
            "give the unit of a time, or the rate of a count",
            file=source,
            where="field import.time",
        )
    if "rate" in entry:
        column = str(entry["column"]) if "column" in entry else None
        return TimeColumn(column, rate=float(entry["rate"]), file=file)
    column = str(entry.get("column", "t"))
    return TimeColumn(column, UNITS[entry.get("unit", "s")], file=file)


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
