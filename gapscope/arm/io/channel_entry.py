"""One channel in the import section of a case: its columns, unit and scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.column_pattern import has_mark, name_of
from gapscope.arm.io.formats.lerobot_calibration import STEPS_PER_TURN
from gapscope.arm.io.transmission import per_joint

UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "rad": 1.0,
    "deg": np.pi / 180,
    "rev": 2 * np.pi,
    "step": 2 * np.pi / STEPS_PER_TURN,
    "m": 1.0,
    "mm": 1e-3,
    "rad/s": 1.0,
    "deg/s": np.pi / 180,
    "rpm": 2 * np.pi / 60,
    "step/s": 2 * np.pi / STEPS_PER_TURN,
    "m/s": 1.0,
    "mm/s": 1e-3,
    "N m": 1.0,
    "mN m": 1e-3,
    "N cm": 1e-2,
    "N": 1.0,
    "kN": 1e3,
    "A": 1.0,
    "mA": 1e-3,
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
