"""The ``import:`` section of a case: how logs in foreign columns, units and on the motor's side become recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import check
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.layouts import STEPS_PER_TURN, UNITS, names_of
from gapscope.arm.nominal import coupled
from gapscope.arm.reading import Columns, Reading
from gapscope.arm.recording import CHANNELS

NORMALISED = "normalised"
"""Unit of positions that run from -100 to 100 over the range of a joint, as LeRobot stores them."""


@dataclass(frozen=True)
class Channel:
    """Where a log holds one channel.

    Attributes:
        column: pattern of the column names, in which ``{j}`` is the joint's number from 1, ``{j0}`` for that
            from 0 and ``{joint}`` for its name; or one name per joint; a pattern without any of these names one
            column whose cells hold lists. In place of a name may stand the number of the column in the file, from 1.
        factor: from the column's unit to the recording's, times the scale; a number or one per joint, (n,).
        offset: added after the factor [recording's unit]; a number or one per joint, (n,).
        file: label of the file that holds it, if several lie side by side.
        topic: topic or table of that file, if it holds several.
        unit: as the import section states it, or empty.
        named: whether the import section names it, so that a case's recordings have to hold it.
        placed: whether it also says in which column; else a format of known layout knows.
        sign_bit: bit that is the sign of the whole number below it; ``None`` for ordinary numbers.
        by_order: the log's names of the joints, if they are taken for the arm's by their order alone.
    """

    column: str | tuple[str, ...]
    factor: float | np.ndarray = 1.0
    offset: float | np.ndarray = 0.0
    file: str | None = None
    topic: str | None = None
    unit: str = ""
    named: bool = False
    placed: bool = False
    sign_bit: int | None = None
    by_order: tuple[str, ...] = ()

    def names(self, joints: Sequence[str]) -> list[str]:
        """Names of the columns: one per joint, or a single one whose cells hold lists."""
        if isinstance(self.column, tuple):
            return list(self.column)
        return names_of(self.column, joints)


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
        rows: row ranges of each file to ``fit`` and to ``judge``, both ends included, counted from 0 below the header;
            without ``fit`` all.
        episodes: those of each dataset to ``fit`` and to ``judge``; without any all are fitted.
        calibration: factor and offset [rad] of positions in normalised units, by motor; ``None`` if there is none.
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
    rows: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    episodes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    calibration: Mapping[str, tuple[float, float]] | None = None
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
            for name in out.keys() & {"q", "dq", "q_ref", "dq_ref"}:
                out[name] = out[name] @ inverse.T
            if "tau" in out:
                # power is the same on both sides: R^T tau_motor, here of rows
                out["tau"] = out["tau"] @ self.transmission
        # behind the transmission, on the joint's side
        return out if self.turned is None else out | self.turned.of_channels(out)


def parse_import(section: Mapping[str, Any], n_joints: int, source: Path) -> Import:
    """Import section of a case.

    Args:
        section: the content of ``import:``, checked here.
        n_joints: number of joints n.
        source: the case file, for messages.

    Raises:
        InputError: it does not follow the case format, a list has not one value per joint, the transmission cannot be
            inverted, or keys contradict.
    """
    check(section, source, "import", "import", n_joints)
    try:
        return Import(**_entries(section, n_joints, source), source=source)
    except InputError as error:
        raise error if error.file else error.at(source) from None


def _entries(section: Mapping[str, Any], n: int, source: Path) -> dict[str, Any]:
    """The attributes of an import section; errors name the field alone."""
    found: dict[str, Any] = {
        key: section[key] for key in ("topic", "join") if key in section
    }
    if "signs" in section or "offsets" in section:
        same = Columns.identity(n)
        signs = map(float, section.get("signs", same.factor))
        offsets = map(float, section.get("offsets", same.offset))
        # a sign turns motion and torque of a joint alike, an offset its positions alone
        torque = replace(same, factor=tuple(signs))
        motion = replace(torque, offset=tuple(offsets))
        turned = {"motion": motion, "torque": torque, "sensor": torque}
        found["turned"] = Reading.identity(n, **turned)
    if "joints" in section:
        found["joints"] = tuple(section["joints"])
    if "transmission" in section:
        found["transmission"] = _transmission(section["transmission"])
    rows = found["rows"] = {}
    for key, ranges in section.get("rows", {}).items():
        # [first, last], or a list of those
        pairs = [ranges] if isinstance(ranges[0], int) else ranges
        for pair in pairs:
            if not isinstance(pair, list) or len(pair) != 2 or pair[0] > pair[1]:
                said = f"expected [first, last] or a list of those, got {ranges}"
                raise InputError(said, where=f"field import.rows.{key}")
        rows[key] = tuple((int(first), int(last)) for first, last in pairs)
    episodes = section.get("episodes", {}).items()
    found["episodes"] = {key: tuple(numbers) for key, numbers in episodes}
    if "calibration" in section:
        found["calibration"] = _calibration(source.parent / section["calibration"])
    if "mend" in section:
        found["mend"] = Reading.from_mend(section["mend"] or {}, n)
    # channels that the section does not name keep the columns of the case format
    channels = {
        name: _channel(name, section[name])
        if name in section
        else Channel(name + "{j}")
        for name in CHANNELS
    }
    time = _time(section.get("time", {"column": "t"}))
    return {**found, "time": time, "channels": channels}


def _time(entry: str | int | Mapping[str, Any]) -> TimeColumn:
    if not isinstance(entry, Mapping):
        return TimeColumn(str(entry))
    file, rate = entry.get("file"), entry.get("rate")
    column = str(entry.get("column", "t"))
    if rate is None:
        return TimeColumn(column, UNITS[entry.get("unit", "s")], file=file)
    # a rate without a column: rows are counted
    counted = column if "column" in entry else None
    return TimeColumn(counted, rate=float(rate), file=file)


# The transmission: q_motor = R q_joint.


def _transmission(entry: Mapping[str, Any]) -> np.ndarray:
    """The matrix R, (n, n), given entry by entry, or by gear ratios and the motors that move with another joint."""
    if "matrix" in entry:
        matrix = np.array(entry["matrix"], dtype=float)
    else:
        # each motor on its own joint with its ratio, then what turns with another joint
        ratios = np.diag(np.array(entry["ratios"], dtype=float))
        where = "field import.transmission.coupling"
        matrix = coupled(ratios, entry.get("coupling", []), where)
    # n independent motors move n joints, or some motion is not recorded
    if np.linalg.matrix_rank(matrix) < len(matrix):
        raise InputError(
            "cannot be inverted",
            "each motor has to move a joint",
            where="field import.transmission",
        )
    return matrix


# One channel: its columns, unit and scale.


def _channel(name: str, entry: Any) -> Channel | None:
    """A channel by its entry, a pattern, names by joint, or a mapping; ``None`` if it is not to be read."""
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        entry = {"column": entry}
    column = entry.get("column", name + "{j}")
    if isinstance(column, list):
        column = tuple(map(str, column))
    elif isinstance(column, int):
        column = str(column)

    def number(key: str) -> np.ndarray:
        """A number, (), or one per joint, (n,); 1 if it is not given."""
        return np.array(entry.get(key, 1.0), dtype=float)

    unit = entry.get("unit", "")
    # of a current; without a ratio its constants are those of the joint's side already
    torque = number("motor_constant") * number("gear_ratio")
    return Channel(
        column,
        number("scale") * torque * UNITS.get(unit, 1.0),
        unit=unit,
        named=True,
        placed="column" in entry,
        **{key: entry.get(key) for key in ("file", "topic", "sign_bit")},
    )


# The calibration file of a LeRobot arm: what its normalised positions are in radians.


_RANGE_KEYS = ("drive_mode", "homing_offset", "range_min", "range_max")


def _calibration(path: Path) -> dict[str, tuple[float, float]]:
    """Factor [rad] and offset [rad] from a motor's normalised position to its angle from the middle of its range.

    That is the zero of LeRobot's degrees, q = (steps - (range_min + range_max) / 2) 2 pi / 4096.

    Raises:
        InputError: there is no such file, or it is not of this form.
    """
    content = read_json(
        path,
        "give the calibration of the arm, ~/.cache/huggingface/lerobot/calibration/robots/*/*.json",
    )
    if not isinstance(content, Mapping) or not content:
        raise InputError("expected a mapping from motors to their ranges", file=path)
    found = {}
    for name, entry in content.items():
        where = f"motor {name}"
        given = entry if isinstance(entry, Mapping) else {}
        if not all(isinstance(given.get(key), (int, float)) for key in _RANGE_KEYS):
            raise InputError(
                f"expected the numbers {', '.join(_RANGE_KEYS)}",
                "give the calibration file that lerobot-calibrate wrote",
                file=path,
                where=where,
            )
        low, high = given["range_min"], given["range_max"]
        if not low < high:
            raise InputError(
                f"range_min {low} is not below range_max {high}",
                "calibrate the arm again",
                file=path,
                where=where,
            )
        span = (high - low) * 2 * np.pi / STEPS_PER_TURN
        from_zero = name.endswith("gripper")
        # from 0 to 100 of a gripper, from -100 to 100 of the others: zero in the middle
        factor, offset = (span / 100, -span / 2) if from_zero else (span / 200, 0.0)
        sign = -1.0 if given["drive_mode"] else 1.0
        found[name] = (sign * factor, sign * offset)
    return found
