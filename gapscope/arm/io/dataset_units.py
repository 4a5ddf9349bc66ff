"""Angles of a LeRobot dataset in radians: it says nowhere whether it holds degrees or normalised positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.channel_entry import NORMALISED, UNITS, Channel
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.layouts import LEROBOT
from gapscope.arm.io.log_channels import Source


def in_radians(
    sources: dict[str, Source], kind: str, importing: Import
) -> dict[str, Source]:
    """The sources, normalised positions with the factor and offset of the arm's calibration.

    Of a LeRobot dataset the action is read as the reference, in the unit of the positions; other channels only if
    the case names them, as their units are known to the recording robot alone.

    Args:
        sources: by channel.
        kind: of the table of the positions.
        importing: what the case says.

    Raises:
        InputError: the unit of a dataset's positions is not stated, or a calibration is missing or lacks a motor.
    """
    if kind == LEROBOT:
        unit = sources["q"].channel.unit
        if not unit:
            raise InputError(
                "a LeRobot dataset does not say whether its positions are degrees, radians or normalised",
                f"say which: import: {{q: {{unit: deg}}}}, rad or {NORMALISED}",
                file=importing.source or sources["q"].table.path,
                where="field import.q.unit",
            )
        sources = {
            name: _with_unit(source, unit if name == "q_ref" else "")
            for name, source in sources.items()
            if source.channel.named or name == "q_ref"
        }
    return {
        name: replace(source, channel=_calibrated(source.channel, name, importing))
        if source.channel.unit == NORMALISED
        else source
        for name, source in sources.items()
    }


def _with_unit(source: Source, unit: str) -> Source:
    """A source whose unit nobody stated, in a unit."""
    channel = source.channel
    if channel.unit or not unit:
        return source
    factor = channel.factor * UNITS.get(unit, 1.0)
    return replace(source, channel=replace(channel, unit=unit, factor=factor))


def _calibrated(channel: Channel, name: str, importing: Import) -> Channel:
    """A channel of normalised positions, as angles [rad]."""
    calibration = importing.calibration
    if calibration is None:
        raise InputError(
            "positions from -100 to 100 are no angles without the ranges of the joints",
            "give the arm's calibration file, import: calibration: FILE.json, or record with use_degrees",
            file=importing.source,
            where=f"field import.{name}.unit",
        )
    motors = [_motor(column) for column in channel.column]
    missing = [motor for motor in motors if motor not in calibration]
    if missing:
        raise InputError(
            f"the calibration has no motor {missing[0]}; it has {', '.join(calibration)}",
            "name the joints as the dataset does in joints: of the import section",
            file=importing.source,
            where="field import.calibration",
        )
    pairs = np.array([calibration[motor].radians for motor in motors])
    return replace(channel, factor=channel.factor * pairs[:, 0], offset=pairs[:, 1])


def _motor(column: str) -> str:
    """Motor of a column such as ``observation.state[elbow_flex.pos]``."""
    return column.rpartition("[")[2].rstrip("]").removesuffix(".pos")
