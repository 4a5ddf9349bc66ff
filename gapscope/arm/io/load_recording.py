"""Recordings from files: any of the formats, through the import section, with the checks a reader owes its user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.channels import join, read_channel, read_time
from gapscope.arm.io.even_rows import EVENLY_TAKEN, even_stamps_of_rows
from gapscope.arm.io.import_section import Channel, Import
from gapscope.arm.io.log import TABLE_READERS
from gapscope.arm.io.plausibility import (
    check_positions,
    gap_notes,
    repeated_rows,
    untrusted_torque,
)
from gapscope.arm.io.rosbag import read_bag
from gapscope.arm.io.table import Table
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording


def load_recording(
    path: str | Path | Mapping[str, Path],
    arm: NominalArm,
    importing: Import | None = None,
    *,
    rows: tuple[int, int] | None = None,
    complete: bool = False,
    every_row: bool = False,
    any_unit: bool = False,
) -> Recording:
    """One recording of ``arm``.

    If ``importing`` describes several files side by side and one file is given, that is treated as the one that
    holds q, and the channels of the others stay unknown. A file in the columns of the case format (t, q1..qn) is
    read as such even if ``importing`` names other columns, unless it has those too.

    Args:
        path: CSV, Parquet, NPZ, MCAP or .db3 file, rosbag2 folder; or the files side by side by label.
        arm: the nominal arm; says how many joints there are and in which order.
        importing: the case's import section.
        rows: first and last row to read, from 0, both included; by default all.
        complete: whether the torque, and every channel that ``importing`` names, must be there; otherwise only
            time and positions have to.
        every_row: keep repeated rows, so that there is one sample for each row of the file.
        any_unit: accept rates and positions that look like another unit, for a diagnosis of the set-up.

    Returns:
        The recording, in SI units, joint side; ``notes`` says what was noticed, dropped or left out.

    Raises:
        InputError: a file is missing, damaged, incomplete or implausible; names file, line and column.
    """
    importing = importing or Import()
    main = importing.main_file
    files = dict(path) if isinstance(path, Mapping) else {main: path}
    tables = {
        label: _table(Path(file), arm, importing) for label, file in files.items()
    }
    if main not in tables:
        raise InputError(
            f"an entry holds the files {', '.join(map(str, tables))}, but q comes from {main}",
            "give each entry a file for every label of the import section",
            file=importing.source,
            where="field recordings",
        )
    if rows is not None:
        # files that are joined by time are cut by the time of the main one
        cut = list(tables) if importing.join == "row" else [main]
        tables |= {label: tables[label].part(*rows) for label in cut}
    recording = _recording(
        tables,
        arm,
        importing,
        complete=complete,
        every_row=every_row,
        any_unit=any_unit,
    )
    if rows is None:
        return recording
    return replace(recording, name=f"{recording.name} rows {rows[0]}-{rows[1]}")


def recording_of_columns(
    name: str, columns: Mapping[str, np.ndarray], arm: NominalArm
) -> Recording:
    """One recording of ``arm`` from columns in memory, in the units of the case format, checked as a file is.

    Args:
        name: of the recording, for messages.
        columns: ``t``, ``q1..qn``, and if known ``tau1..``, ``dq1..``, ... , shape (N,) each.
        arm: the nominal arm.

    Raises:
        InputError: a column is missing, no number or implausible; names row and column.
    """
    length = len(next(iter(columns.values()), ()))
    table = Table(Path(name), columns, range(1, length + 1))
    return _recording({None: table}, arm, Import(), any_unit=True)


def _recording(
    tables: Mapping[str | None, Table],
    arm: NominalArm,
    importing: Import,
    *,
    complete: bool = False,
    every_row: bool = False,
    any_unit: bool = False,
) -> Recording:
    """One recording from its tables; see ``load_recording``."""
    main = tables[importing.main_file]
    importing, notes = _fitting(importing, main, arm)
    t = read_time(main, importing, any_unit=any_unit)
    t, values, found = _channels(t, tables, main, arm, importing, complete)
    notes += found
    if not every_row:
        repeated, found = repeated_rows(t, values)
        t = t[~repeated]
        values = {name: x[~repeated] for name, x in values.items()}
        notes += found
        even = even_stamps_of_rows(t, values["q"]) if repeated.any() else None
        if even is not None:
            t = even
            notes += (EVENLY_TAKEN,)
    values, found = untrusted_torque(values)
    notes += found + gap_notes(t)
    recording = Recording(main.path.name, t, **values)  # type: ignore[arg-type]
    notes += check_positions(recording, arm, main, any_unit=any_unit)
    return replace(recording, notes=notes)


def _table(path: Path, arm: NominalArm, importing: Import) -> Table:
    """One file as a table."""
    if not path.exists():
        raise InputError("no such file or folder", "check the path", file=path)
    if path.is_dir() or path.suffix in (".db3", ".mcap"):
        return read_bag(path, arm, topic=importing.topic, joints=importing.joints)
    if path.suffix in TABLE_READERS:
        return TABLE_READERS[path.suffix](path)
    raise InputError(
        f"the ending {path.suffix!r} names no known format",
        f"give a file that ends in {', '.join(TABLE_READERS)}, .mcap or .db3, or a rosbag2 folder",
        file=path,
    )


def _fitting(
    importing: Import, main: Table, arm: NominalArm
) -> tuple[Import, tuple[str, ...]]:
    """The import section, or none for a file that is in the columns of the case format already; and notes."""
    channel = importing.channels["q"]
    assert channel is not None
    named = any(name in main.columns for name in channel.names(arm.joints))
    if named or "q1" not in main.columns:
        return importing, main.notes
    note = "read in the columns of the case format, not by the import section"
    return Import(), (*main.notes, note)


def _channels(
    t: np.ndarray,
    tables: Mapping[str | None, Table],
    main: Table,
    arm: NominalArm,
    importing: Import,
    complete: bool,
) -> tuple[np.ndarray, dict[str, np.ndarray], tuple[str, ...]]:
    """Time [s], (N,), and channels in SI units on the joint side, (N, n) each, if all files have them; notes."""
    values: dict[str, np.ndarray] = {}
    inside = np.ones(len(main), dtype=bool)
    for name, channel in importing.channels.items():
        if channel is None:
            continue
        required = name == "q" or (complete and (channel.named or name == "tau"))
        table = main if channel.file is None else tables.get(channel.file)
        if table is None:
            if required:
                raise _missing_file(name, channel, tables, importing)
            continue
        read = read_channel(table, channel, arm, required=required)
        if read is None:
            continue
        if table is not main:
            read, covered = join(read, table, main, t, importing)
            inside &= covered
        values[name] = read
    covered_by_all = {name: x[inside] for name, x in values.items()}
    cut = int((~inside).sum())
    note = f"rows cut outside the time of the other files: {cut}"
    notes = (note,) if cut else ()
    return t[inside], importing.to_joint_side(covered_by_all), notes


def _missing_file(
    name: str,
    channel: Channel,
    tables: Mapping[str | None, Table],
    importing: Import,
) -> InputError:
    """The error on a channel whose file an entry does not give."""
    return InputError(
        f"comes from the file {channel.file}, an entry holds {', '.join(map(str, tables))}",
        "give each entry a file for every label of the import section",
        file=importing.source,
        where=f"field import.{name}",
    )
