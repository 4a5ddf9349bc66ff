"""One channel out of the columns of a table, and onto the time of another table."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from gapscope.arm.errors import InputError
from gapscope.arm.io.channel_entry import Channel
from gapscope.arm.io.column_pattern import name_of
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.plausibility import check_time
from gapscope.arm.io.table import Table
from gapscope.arm.nominal import NominalArm


def read_time(table: Table, importing: Import, *, any_unit: bool = False) -> np.ndarray:
    """Time of each row [s], shape (N,).

    Raises:
        InputError: the column is missing or no number, jumps back, or has an implausible rate.
    """
    t = stamps(table, importing)
    check_time(t, table, importing.time.column or "time", any_unit=any_unit)
    return t


def stamps(table: Table, importing: Import) -> np.ndarray:
    """Time of each row [s], shape (N,), whatever it holds.

    Raises:
        InputError: the column is missing or no number.
    """
    time = importing.time
    rows = table.row_numbers
    count = np.asarray(rows) if time.column is None else table.numbers(time.column)
    t = count / time.rate if time.rate is not None else count * time.factor
    mend = importing.mend
    return t if mend is None else mend.true_time(t, table.path.name)


def read_channel(table: Table, channel: Channel, arm: NominalArm) -> np.ndarray:
    """A channel in SI units, shape (N, n).

    Raises:
        InputError: a column is missing, a cell is no finite number, or the table has columns for more joints than
            the arm.
    """
    names = channel.names(arm.joints)
    if len(names) == 1 and arm.n_joints > 1:
        raw = table.lists(names[0], arm.n_joints)
        return raw * channel.factor + channel.offset
    values = np.column_stack([table.numbers(name) for name in names])
    # a pattern that also names a joint beyond the last one: another arm
    surplus = ""
    if isinstance(channel.column, str):
        surplus = name_of(channel.column, arm.n_joints, "")
    if surplus in table.columns:
        raise InputError(
            f"has a column {surplus}, but the arm has only {arm.n_joints} joints: {', '.join(arm.joints)}",
            "give the URDF of the recorded arm, or list the columns to use in the case's import section",
            file=table.path,
        )
    # in place: a channel of a long log is large
    values *= channel.factor
    values += channel.offset
    return values


def how_to_join(table: Table, importing: Import) -> str:
    """``row``, ``interpolate`` or ``hold``: topics have times of their own, files usually the same rows."""
    by_kind = "interpolate" if table.place_kind == "message" else "row"
    return importing.join or by_kind


def join(
    values: np.ndarray, table: Table, main: Table, t: np.ndarray, importing: Import
) -> tuple[np.ndarray, np.ndarray]:
    """A channel of ``table`` at the rows of ``main``, (N, n), and which of those rows it covers, (N,).

    Args:
        values: the channel at the rows of ``table``, (M, n).
        table: the table that it comes from.
        main: the table that holds q.
        t: time of the rows of ``main`` [s], (N,).
        importing: says how to join.

    Raises:
        InputError: row by row, and the files differ in length; or by time, and they do not overlap.
    """
    if how_to_join(table, importing) == "row":
        if len(table) != len(main):
            raise InputError(
                f"has {len(table)} rows, {main.path.name} has {len(main)}",
                "give files with the same rows, or join: interpolate or hold and a time column in each",
                file=table.path,
            )
        return values, np.ones(len(main), dtype=bool)
    # the time of messages is in s whatever their rate
    any_unit = table.place_kind == "message"
    time = read_time(table, importing, any_unit=any_unit)
    covered = (t >= time[0]) & ((t <= time[-1]) | (importing.join == "hold"))
    if not covered.any():
        raise InputError(
            f"does not overlap in time with {main.path.name}: {time[0]:.6g} to {time[-1]:.6g} s, "
            f"against {t[0]:.6g} to {t[-1]:.6g} s",
            "give both files the same clock",
            file=table.path,
        )
    if importing.join == "hold":
        last = np.searchsorted(time, t, side="right") - 1
        return values[np.maximum(last, 0)], covered
    # straight lines would look like the set points of a slow controller; PCHIP does not overshoot steps
    different = np.r_[True, np.diff(time) > 0]
    curve = PchipInterpolator(time[different], values[different])
    return curve(np.clip(t, time[0], time[-1])), covered
