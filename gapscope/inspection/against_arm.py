"""A log against the nominal arm: which columns are the arm's joints, and how it explains each torque column."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.import_section import UNITS
from gapscope.arm.io.load_recording import recording_of_columns
from gapscope.arm.io.samples.damaged import BEYOND
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Columns
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.inspection.channels import ChannelGuess
from gapscope.inspection.columns import ColumnGroup
from gapscope.inspection.inspected_table import InspectedTable
from gapscope.inspection.time_column import TimeGuess
from gapscope.inspection.torque_fit import TorqueFit, fits_of

LONGEST = 60.0
"""Duration of each recording that is looked at [s]."""


def arm_of_columns(arm: NominalArm, group: ColumnGroup) -> NominalArm:
    """The arm with those of its joints that a log has: by name, or the first if it has fewer and names none."""
    named = [joint for joint in arm.joints if joint in group.labels]
    kept = named or list(arm.joints[: group.width])
    if len(kept) == arm.n_joints:
        return arm
    return load_nominal_arm(arm.urdf, joints=kept, gravity=tuple(arm.gravity))


def columns_of_arm(group: ColumnGroup, joints: Sequence[str]) -> list[int] | None:
    """Places in a group, from 0, of the joints of the arm; ``None`` if it has fewer columns.

    By name if the columns carry the names of the joints, in their order otherwise.
    """
    if set(joints) <= set(group.labels):
        return [group.labels.index(joint) for joint in joints]
    return list(range(len(joints))) if group.width >= len(joints) else None


def torque_fits(
    arm: NominalArm, entries: Sequence[dict[str, InspectedTable]], torque: ChannelGuess
) -> list[TorqueFit]:
    """How the nominal arm explains a torque column, gravity in and out, the better first; none if it cannot be asked.

    Args:
        arm: the nominal arm.
        entries: the tables of each recording.
        torque: the columns in question, by the pattern that all recordings share.
    """
    recordings = []
    for entry in entries:
        recording = _recording(arm, entry, torque)
        # a torque that is silent or unsigned is set aside on reading
        if recording is not None and recording.tau is not None:
            recordings.append(recording)
    if not recordings:
        return []
    try:
        return fits_of(arm, recordings)
    except GapscopeError:
        # too short or too coarse to differentiate: nothing can be said
        return []


def _recording(
    arm: NominalArm, entry: dict[str, InspectedTable], torque: ChannelGuess
) -> Recording | None:
    """Positions and one torque column as a recording; ``None`` if they do not stand row by row."""
    main = next(iter(entry.values()))
    position = main.best("q")
    values = _values(entry, torque)
    if position is None or values is None or len(values) != len(main.time.seconds):
        return None
    rows = main.time.seconds <= LONGEST
    columns = {"t": main.time.seconds[rows]}
    factor = UNITS[position.unit]
    for name, group, scale in (
        ("q", position.group, factor),
        ("tau", None, 1.0),
    ):
        series = values if group is None else group.values
        places = columns_of_arm(group or torque.group, arm.joints)
        if places is None:
            return None
        n = len(places)
        read = Columns(tuple(places), (scale,) * n, (0.0,) * n)(series[rows])
        columns |= {f"{name}{j}": x for j, x in enumerate(read.T, start=1)}
    if max(np.abs(column).max(initial=0.0) for column in columns.values()) > BEYOND:
        return None
    try:
        return recording_of_columns(main.label, columns, arm)
    except GapscopeError:
        # cells that are no numbers, or a clock that runs back: the oddities say so
        return None


def _values(
    entry: dict[str, InspectedTable], torque: ChannelGuess
) -> np.ndarray | None:
    """The columns of a torque in one recording, at the rows of its positions."""
    main = next(iter(entry.values()))
    for table in entry.values():
        for guess in table.channels:
            same = guess.group.pattern == torque.group.pattern
            if same and guess.channel == torque.channel:
                return _at_rows_of(main.time, table.time, guess.group.values)
    return None


def _at_rows_of(
    main: TimeGuess, own: TimeGuess, values: np.ndarray
) -> np.ndarray | None:
    """Values at the rows of another table, by its clock if it has other rows; ``None`` without a common clock."""
    if len(values) == len(main.seconds):
        return values
    if not (own.column and main.column):
        return None
    t = main.start + main.seconds
    columns = [np.interp(t, own.start + own.seconds, column) for column in values.T]
    return np.column_stack(columns)
