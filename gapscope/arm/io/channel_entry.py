"""One channel in the import section of a case: its columns, unit, scale, calibration; and the transmission of all."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import centi, degree, kilo, micro, milli, minute, nano

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import read_json
from gapscope.arm.nominal import coupled

# The calibration file of a LeRobot arm: what its normalised positions are in radians.


STEPS_PER_TURN = 4096
"""Encoder steps in a turn of the servos [1]: Feetech STS3215, Dynamixel X series."""
GRIPPER = "gripper"
"""The motor whose positions run from 0 to 100; all others from -100 to 100."""

_RANGE_KEYS = ("drive_mode", "homing_offset", "range_min", "range_max")


@dataclass(frozen=True)
class MotorRange:
    """Range of one motor, which its normalised positions span.

    Attributes:
        range_min, range_max: ends of the range, after the homing offset [encoder steps].
        reversed: whether the normalised position falls while the encoder counts up.
        from_zero: whether it runs from 0 to 100, not from -100 to 100.
    """

    range_min: float
    range_max: float
    reversed: bool = False
    from_zero: bool = False

    @property
    def radians(self) -> tuple[float, float]:
        """Factor [rad] and offset [rad] from the normalised position to the angle from the middle of the range.

        That is the zero of LeRobot's degrees, q = (steps - (range_min + range_max) / 2) 2 pi / 4096.
        """
        span = (self.range_max - self.range_min) * 2 * np.pi / STEPS_PER_TURN
        factor, offset = (span / 100, -span / 2) if self.from_zero else (span / 200, 0)
        return (-factor, -offset) if self.reversed else (factor, offset)


def read_calibration(path: Path) -> dict[str, MotorRange]:
    """Ranges by the motors' names, from a calibration file of LeRobot.

    Raises:
        InputError: there is no such file, or it is not of this form.
    """
    content = read_json(
        path,
        "give the calibration of the arm, ~/.cache/huggingface/lerobot/calibration/robots/*/*.json",
    )
    if not isinstance(content, Mapping) or not content:
        raise InputError("expected a mapping from motors to their ranges", file=path)
    return {name: _range(name, entry, path) for name, entry in content.items()}


def _range(name: str, entry: object, path: Path) -> MotorRange:
    if not isinstance(entry, Mapping) or any(
        not isinstance(entry.get(key), (int, float)) for key in _RANGE_KEYS
    ):
        raise InputError(
            f"expected the numbers {', '.join(_RANGE_KEYS)}",
            "give the calibration file that lerobot-calibrate wrote",
            file=path,
            where=f"motor {name}",
        )
    low, high = entry["range_min"], entry["range_max"]
    if not low < high:
        raise InputError(
            f"range_min {low} is not below range_max {high}",
            "calibrate the arm again",
            file=path,
            where=f"motor {name}",
        )
    return MotorRange(low, high, bool(entry["drive_mode"]), name.endswith(GRIPPER))


# The transmission in the import section of a case: q_motor = R q_joint.


def per_joint(
    values: Any, n_joints: int, source: Path, key: str, kind: type = float
) -> Any:
    """Values of a list in the import section, one per joint: numbers as an array (n,), texts as a list; else raises."""
    if len(values) != n_joints:
        raise InputError(
            f"expected {n_joints} entries, one per joint, got {len(values)}",
            file=source,
            where=f"field import.{key}",
        )
    return np.array(values, dtype=float) if kind is float else list(map(str, values))


def parse_transmission(
    entry: Mapping[str, Any], n_joints: int, source: Path
) -> np.ndarray:
    """The matrix R of q_motor = R q_joint, (n, n)."""
    where = "field import.transmission"
    has_matrix, has_ratios = "matrix" in entry, "ratios" in entry
    if has_matrix == has_ratios or (has_matrix and "coupling" in entry):
        raise InputError(
            "expected either matrix, or ratios with or without coupling",
            file=source,
            where=where,
        )
    if has_matrix:
        matrix = _full_matrix(entry["matrix"], n_joints, source, where)
    else:
        matrix = _coupled_ratios(entry, n_joints, source, where)
    if np.linalg.matrix_rank(matrix) < n_joints:
        raise InputError(
            "cannot be inverted",
            "each motor has to move a joint",
            file=source,
            where=where,
        )
    return matrix


def _full_matrix(
    rows: list[list[float]], n_joints: int, source: Path, where: str
) -> np.ndarray:
    """A transmission that is given entry by entry, (n, n)."""
    if [len(row) for row in rows] != [n_joints] * n_joints:
        raise InputError(
            f"expected a matrix of {n_joints} by {n_joints} numbers",
            file=source,
            where=f"{where}.matrix",
        )
    return np.array(rows, dtype=float)


def _coupled_ratios(
    entry: Mapping[str, Any], n_joints: int, source: Path, where: str
) -> np.ndarray:
    """A transmission by gear ratios and the motors that move with another joint, (n, n)."""
    ratios = per_joint(entry["ratios"], n_joints, source, "transmission.ratios")
    try:
        entries = entry.get("coupling", [])
        return coupled(np.diag(ratios), entries, f"{where}.coupling")
    except InputError as error:
        raise error.at(source) from None


# Patterns of column names: ``{j}`` is the joint's number from 1, ``{j0}`` that from 0, ``{joint}`` its name.


_MARKS = {"{j}": r"(\d+)", "{j0}": r"(\d+)", "{joint}": r"(.+)"}


def has_mark(pattern: str) -> bool:
    """Whether a pattern names one column for each joint; else it names one whose cells hold lists."""
    return any(mark in pattern for mark in _MARKS)


def name_of(pattern: str, j: int, joint: str) -> str:
    """Name of the column of joint ``j``, from 0."""
    numbered = pattern.replace("{j}", str(j + 1)).replace("{j0}", str(j))
    return numbered.replace("{joint}", joint)


def joints_in(pattern: str, columns: Iterable[str]) -> list[str]:
    """What stands for the joint in the columns that follow a pattern: names, or numbers that count without a gap.

    >>> joints_in("q[{j0}]", ["q[0]", "q[1]", "q[3]"])
    ['0', '1']
    """
    mark = next((mark for mark in _MARKS if mark in pattern), None)
    if mark is None:
        return []
    before, after = pattern.split(mark, 1)
    expression = re.compile(re.escape(before) + _MARKS[mark] + re.escape(after))
    found = [m[1] for m in map(expression.fullmatch, columns) if m]
    if mark == "{joint}":
        return found
    return _counted(found, first=1 if mark == "{j}" else 0)


def _counted(numbers: Sequence[str], first: int) -> list[str]:
    """The numbers from the first on, as far as they follow each other."""
    counted: list[str] = []
    while str(first + len(counted)) in numbers:
        counted.append(str(first + len(counted)))
    return counted


UNITS = {
    "s": 1.0,
    "ms": milli,
    "us": micro,
    "ns": nano,
    "rad": 1.0,
    "deg": degree,
    "rev": 2 * np.pi,
    "step": 2 * np.pi / STEPS_PER_TURN,
    "m": 1.0,
    "mm": milli,
    "rad/s": 1.0,
    "deg/s": degree,
    "rpm": 2 * np.pi / minute,
    "step/s": 2 * np.pi / STEPS_PER_TURN,
    "m/s": 1.0,
    "mm/s": milli,
    "N m": 1.0,
    "mN m": milli,
    "N cm": centi,
    "N": 1.0,
    "kN": kilo,
    "A": 1.0,
    "mA": milli,
    "degC": 1.0,
}
"""Factor from a unit to the one that a recording holds; from a current to A."""

SIGN_BITS = (10, 15)
"""Bits in which Feetech servos keep the sign of a load, and of a speed; the lower ones hold the magnitude."""

NORMALISED = "normalised"
"""Unit of positions that run from -100 to 100 over the range of a joint, as LeRobot stores them."""

_CURRENTS = ("A", "mA")


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

    def names(self, joints: Sequence[str]) -> list[str]:
        """Names of the columns: one per joint, or a single one whose cells hold lists."""
        if isinstance(self.column, tuple):
            return list(self.column)
        if not has_mark(self.column):
            return [self.column]
        return [name_of(self.column, j, joint) for j, joint in enumerate(joints)]


def parse_channel(name: str, entry: Any, n_joints: int, source: Path) -> Channel | None:
    """Entry of one channel in the import section; ``None`` if the channel is not to be read.

    Args:
        name: of the channel.
        entry: a pattern, names by joint, or a mapping.
        n_joints: number of joints n.
        source: the case file, for messages.

    Raises:
        InputError: a list has not one value per joint, or a current lacks what makes it a torque.
    """
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        entry = {"column": entry}
    column = entry.get("column", name + "{j}")
    if isinstance(column, list):
        column = tuple(per_joint(column, n_joints, source, f"{name}.column", str))
    elif isinstance(column, int):
        column = str(column)
    unit = entry.get("unit", "")
    factor = _per_joint_or_one(entry, "scale", name, n_joints, source)
    if unit in _CURRENTS:
        factor = factor * _torque_per_ampere(entry, name, n_joints, source)
    elif "motor_constant" in entry or "gear_ratio" in entry:
        raise InputError(
            "has a motor_constant or gear_ratio, but no current",
            "say unit: A, or use scale: for a column in another unit",
            file=source,
            where=f"field import.{name}",
        )
    return Channel(
        column,
        factor * UNITS.get(unit, 1.0),
        file=entry.get("file"),
        topic=entry.get("topic"),
        unit=unit,
        named=True,
        placed="column" in entry,
        sign_bit=entry.get("sign_bit"),
    )


def with_sign(raw: np.ndarray, bit: int) -> np.ndarray:
    """Whole numbers whose bit says the sign of what is below it, as numbers."""
    turned, magnitude = np.divmod(raw, 2.0**bit)
    return np.asarray(np.where(turned == 1, -magnitude, magnitude))


def _torque_per_ampere(
    entry: Mapping[str, Any], name: str, n_joints: int, source: Path
) -> Any:
    """Motor constant times gear ratio [N m/A], a number or one per joint, (n,)."""
    if "motor_constant" not in entry:
        raise InputError(
            "is a current, and a torque needs the motors' constants",
            "give motor_constant: [...] in N m/A per joint, and gear_ratio: [...] unless the constants are those of "
            "the joints' side already",
            file=source,
            where=f"field import.{name}",
        )
    constant = _per_joint_or_one(entry, "motor_constant", name, n_joints, source)
    return constant * _per_joint_or_one(entry, "gear_ratio", name, n_joints, source)


def _per_joint_or_one(
    entry: Mapping[str, Any], key: str, name: str, n_joints: int, source: Path
) -> Any:
    """A number, or one per joint, (n,); 1 if it is not given."""
    value = entry.get(key, 1.0)
    if isinstance(value, list):
        return per_joint(value, n_joints, source, f"{name}.{key}")
    return value
