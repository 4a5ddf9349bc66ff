"""The calibration file of a LeRobot arm: what its normalised positions are in radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import read_json

STEPS_PER_TURN = 4096
"""Encoder steps in a turn of the servos [1]: Feetech STS3215, Dynamixel X series."""
GRIPPER = "gripper"
"""The motor whose positions run from 0 to 100; all others from -100 to 100."""

_KEYS = ("drive_mode", "homing_offset", "range_min", "range_max")


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
        not isinstance(entry.get(key), (int, float)) for key in _KEYS
    ):
        raise InputError(
            f"expected the numbers {', '.join(_KEYS)}",
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
