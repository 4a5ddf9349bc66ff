"""A recording from its log: rows evened, parts split, units of datasets, samples put right."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.bad_samples import stuck_rows, without_spikes
from gapscope.arm.io.channel_entry import Channel
from gapscope.arm.io.channels import (
    Locator,
    Source,
    how_to_join,
    in_radians,
    join,
    read_channel,
    read_time,
    stamps,
)
from gapscope.arm.io.damaged_rows import damage
from gapscope.arm.io.even_rows import EVENLY_TAKEN, even_stamps_of_rows
from gapscope.arm.io.formats.lerobot import (
    dataset_episodes,
    episode_name,
    is_dataset,
    read_dataset,
)
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.layouts import layout_of_kind
from gapscope.arm.io.log import open_log
from gapscope.arm.io.plausibility import (
    check_positions,
    gap_notes,
    repeated_rows,
    untrusted_torque,
    without_turns,
)
from gapscope.arm.io.table import Log, LogTable, Table
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording, held_notes, step_notes

# The parts of a case's files that are recordings of their own: ranges of rows, episodes of a dataset.


Entry = Path | dict[str, Path]
"""A file, or files side by side by label."""


@dataclass(frozen=True)
class Part:
    """One recording of an entry.

    Attributes:
        entry: the file, or files side by side.
        rows: first and last row, from 0, both included; ``None``: all.
        episode: of a dataset; ``None`` for other files.
    """

    entry: Entry
    rows: tuple[int, int] | None = None
    episode: int | None = None


def fitted_parts(entry: Entry, importing: Import) -> list[Part]:
    """The recordings of an entry that may be fitted: by default all rows, of all episodes.

    An episode may also be named as a table is, in ``topic``.
    """
    episodes: Iterable[int] = importing.fit_episodes
    if isinstance(entry, Path) and is_dataset(entry):
        episodes = episodes or dataset_episodes(entry)
        if importing.topic is not None:
            episodes = [k for k in episodes if episode_name(k) == importing.topic]
        return [Part(entry, episode=episode) for episode in episodes]
    return _ranges(entry, importing.fit or (None,))


def judged_parts(entry: Entry, importing: Import) -> list[Part]:
    """The recordings of an entry that are held out: none by default."""
    if isinstance(entry, Path) and is_dataset(entry):
        return [Part(entry, episode=episode) for episode in importing.judge_episodes]
    return _ranges(entry, importing.judge)


def whole_parts(entry: Entry) -> list[Part]:
    """All recordings of an entry that is held out whole."""
    return fitted_parts(entry, Import())


def _ranges(entry: Entry, ranges: Sequence[tuple[int, int] | None]) -> list[Part]:
    return [Part(entry, rows) for rows in ranges]


# Recordings from files: any of the formats, through the import section, with the checks a reader owes its user.


SAID_START = 1.0
"""A log whose first stamp is farther from 0 has a note that says so [s]."""
FROM_FIRST_ROW = "time is counted from the first row, whose stamp is {:.10g} s"


def load_recording(
    path: str | Path | Mapping[str, Path],
    arm: NominalArm,
    importing: Import | None = None,
    *,
    rows: tuple[int, int] | None = None,
    episode: int | None = None,
    complete: bool = False,
    every_row: bool = False,
    any_unit: bool = False,
    payload: KnownLoad | None = None,
) -> Recording:
    """One recording of ``arm``.

    If ``importing`` describes several files side by side and one file is given, that is treated as the one that
    holds q, and the channels of the others stay unknown. A file in the columns of the case format (t, q1..qn) is
    read as such even if ``importing`` names other columns, unless it has those too.

    Args:
        path: file or folder of any format of ``open_log``; or the files side by side by label.
        arm: the nominal arm; says how many joints there are and in which order.
        importing: the case's import section.
        rows: first and last row to read, from 0, both included; by default all.
        episode: of a dataset.
        complete: whether the torque, and every channel that ``importing`` names, must be there; otherwise only
            time and positions have to.
        every_row: keep repeated rows, so that there is one sample for each row of the file.
        any_unit: accept rates and positions that look like another unit, for a diagnosis of the set-up.
        payload: known body that was mounted on the last link.

    Returns:
        The recording, in SI units, joint side; ``notes`` says what was noticed, dropped or left out.

    Raises:
        InputError: a file is missing, damaged, incomplete or implausible; names file, line and column.
    """
    importing = importing or Import()
    main = importing.main_file
    files = dict(path) if isinstance(path, Mapping) else {main: path}
    logs = {
        label: _log(Path(file), episode, importing) for label, file in files.items()
    }
    if main not in logs:
        raise InputError(
            f"an entry holds the files {', '.join(map(str, logs))}, but q comes from {main}",
            "give each entry a file for every label of the import section",
            file=importing.source,
            where="field recordings",
        )
    recording = _recording(
        logs,
        arm,
        importing,
        rows=rows,
        complete=complete,
        every_row=every_row,
        any_unit=any_unit,
        payload=payload,
    )
    if is_dataset(logs[main].path) and len(logs[main].tables) == 1:
        label = f"{recording.name} {logs[main].tables[0].name}"
        recording = replace(recording, name=label)
    if rows is None:
        return recording
    return replace(recording, name=f"{recording.name} rows {rows[0]}-{rows[1]}")


def _log(path: Path, episode: int | None, importing: Import) -> Log:
    """A file as a log; of a dataset one episode, or those that the case names."""
    if not is_dataset(path):
        return open_log(path)
    named = (*importing.fit_episodes, *importing.judge_episodes) or None
    return read_dataset(path, named if episode is None else [episode])


def recording_of_log(
    log: Log, arm: NominalArm, importing: Import | None = None
) -> Recording:
    """One recording of ``arm`` from a log that was read already, such as the newest rows of one that grows.

    Args:
        log: with the positions.
        arm: the nominal arm.
        importing: the case's import section.

    Raises:
        InputError: a channel is missing or implausible; names line and column.
    """
    importing = importing or Import()
    return _recording({importing.main_file: log}, arm, importing)


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
    log = Log(table.path, "columns", (LogTable("", "columns", table),))
    return _recording({None: log}, arm, Import(), any_unit=True)


def _recording(
    logs: Mapping[str | None, Log],
    arm: NominalArm,
    importing: Import,
    *,
    rows: tuple[int, int] | None = None,
    complete: bool = False,
    every_row: bool = False,
    any_unit: bool = False,
    payload: KnownLoad | None = None,
) -> Recording:
    """One recording from its logs; see ``load_recording``."""
    importing, notes = _fitting(importing, logs[importing.main_file], arm)
    sources, found = _sources(logs, arm, importing, complete)
    notes += found
    sources, importing = _timed(sources, logs, importing)
    begun = _first_stamp(sources["q"].table, importing)
    if rows is not None:
        sources = _cut(sources, rows, importing)
    sources, found = _sound(sources, arm, importing)
    notes += found
    main = sources["q"].table
    t = read_time(main, importing, any_unit=any_unit)
    t, values, found = _channels(t, sources, arm, importing)
    notes += found
    if not every_row:
        repeated, found = repeated_rows(t, values)
        if repeated.any():
            t = t[~repeated]
            values = {name: x[~repeated] for name, x in values.items()}
        notes += found
        even = even_stamps_of_rows(t, values["q"]) if repeated.any() else None
        if even is not None:
            t = even
            notes += (EVENLY_TAKEN,)
    # a part of the rows is warm from those before it: its time goes on from the first row of the log
    t = t - begun
    if abs(begun) > SAID_START:
        notes += (FROM_FIRST_ROW.format(begun),)
    values, turns = without_turns(values)
    values, found = untrusted_torque(values)
    notes += turns + found
    if not every_row:
        values, spiked = without_spikes(t, values, arm.per_radian)
        stuck, found = stuck_rows(t, values["q"])
        if stuck.any():
            t, values = t[~stuck], {name: x[~stuck] for name, x in values.items()}
        notes += spiked + found
    notes += gap_notes(t)
    # read-only from here on, so that the recording shares them
    for series in (t, *values.values()):
        series.setflags(write=False)
    recording = Recording(main.path.name, t, payload=payload, begun=begun, **values)  # type: ignore[arg-type]
    if importing.mend is not None:
        mend = importing.mend.of_right_time
        recording = (mend.of_every_row if every_row else mend)(recording, arm)
    notes += check_positions(recording, arm, main, any_unit=any_unit)
    if not every_row:
        notes += held_notes(recording) + step_notes(recording)
    return replace(recording, notes=notes)


def _timed(
    sources: dict[str, Source], logs: Mapping[str | None, Log], importing: Import
) -> tuple[dict[str, Source], Import]:
    """The sources with the time of another file as a column of that of the positions, if the case says so.

    Raises:
        InputError: the entry has no such file, or it has other rows.
    """
    label, column = importing.time.file, importing.time.column
    if label is None or label == importing.main_file or column is None:
        return sources, importing
    if label not in logs:
        raise _missing_file("time", label, logs, importing)
    main, other = sources["q"].table, logs[label].tables[0].table
    if len(other) != len(main):
        raise InputError(
            f"has {len(other)} rows, {main.path.name} has {len(main)}",
            "give a file of the time with the same rows",
            file=other.path,
        )
    name = f"{column} of {other.path.name}"
    timed = replace(main, columns={**main.columns, name: other.cells(column)})
    moved = {
        channel: replace(source, table=timed) if source.table is main else source
        for channel, source in sources.items()
    }
    return moved, replace(importing, time=replace(importing.time, column=name))


def _first_stamp(table: Table, importing: Import) -> float:
    """Time of the first row of a log that has one [s]; 0 if none has."""
    for row in range(len(table)):
        with suppress(InputError):
            return float(stamps(table.part(row, row), importing)[0])
    return 0.0


def _fitting(
    importing: Import, log: Log, arm: NominalArm
) -> tuple[Import, tuple[str, ...]]:
    """The import section, or none for a file that is in the columns of the case format already; and notes."""
    channel = importing.channels["q"]
    assert channel is not None
    if len(log.tables) != 1:
        return importing, ()
    main = log.tables[0].table
    named = any(main.named(name) in main.columns for name in channel.names(arm.joints))
    if named or "q1" not in main.columns:
        return importing, ()
    return Import(), (
        "read in the columns of the case format, not by the import section",
    )


def _sources(
    logs: Mapping[str | None, Log],
    arm: NominalArm,
    importing: Import,
    complete: bool,
) -> tuple[dict[str, Source], tuple[str, ...]]:
    """Where each channel that can be had comes from; and notes.

    Raises:
        InputError: one that is needed is missing.
    """
    locator = Locator(logs, importing, arm)
    main, q, notes = locator.positions()
    sources = {"q": q}
    for name, channel in importing.channels.items():
        if channel is None or name == "q":
            continue
        required = complete and (channel.named or name == "tau")
        if channel.file not in logs:
            if required:
                raise _missing_file(name, channel.file, logs, importing)
            continue
        source, found = locator.other(name, channel, main)
        notes += found
        if source is not None:
            sources[name] = source
        elif required:
            raise _missing_channel(name, channel, logs[channel.file], main, arm, found)
    return in_radians(sources, main.kind, importing), notes


def _cut(
    sources: dict[str, Source], rows: tuple[int, int], importing: Import
) -> dict[str, Source]:
    """The sources with some rows alone; what is joined by time is cut by the time of the positions."""
    main = sources["q"].table
    parts: dict[int, Table] = {}
    for table in (source.table for source in sources.values()):
        by_row = table is main or how_to_join(table, importing) == "row"
        parts[id(table)] = table.part(*rows) if by_row else table
    return {
        name: replace(source, table=parts[id(source.table)])
        for name, source in sources.items()
    }


def _sound(
    sources: dict[str, Source], arm: NominalArm, importing: Import
) -> tuple[dict[str, Source], tuple[str, ...]]:
    """The sources without rows that cannot be read, and notes on them; tables that are joined by row lose the same.

    Raises:
        InputError: there are too many.
    """
    main, time = sources["q"].table, importing.time.column
    tables = {id(source.table): source.table for source in sources.values()}
    read: dict[int, list[str]] = {key: [] for key in tables}
    for source in sources.values():
        read[id(source.table)] += source.channel.names(arm.joints)
    found = {key: damage(x, read[key], time) for key, x in tables.items()}
    beside = [
        key
        for key, table in tables.items()
        if how_to_join(table, importing) == "row" and len(table) == len(main)
    ]
    whole = found[id(main)]
    for key in beside:
        whole |= found[key]
    found |= dict.fromkeys([id(main), *beside], whole)
    notes: list[str] = []
    sound: dict[int, Table] = {}
    for key, table in tables.items():
        said = found[key].notes(table)
        notes += said if table is main or key not in beside else []
        sound[key] = table.some(found[key].sound) if said else table
    moved = {
        name: replace(source, table=sound[id(source.table)])
        for name, source in sources.items()
    }
    return moved, tuple(notes)


def _channels(
    t: np.ndarray,
    sources: Mapping[str, Source],
    arm: NominalArm,
    importing: Import,
) -> tuple[np.ndarray, dict[str, np.ndarray], tuple[str, ...]]:
    """Time [s], (N,), and channels in SI units on the joint side, (N, n) each, if all tables have them; notes."""
    values: dict[str, np.ndarray] = {}
    main = sources["q"].table
    inside = np.ones(len(main), dtype=bool)
    for name, source in sources.items():
        read = read_channel(source.table, source.channel, arm)
        if source.table is not main:
            read, covered = join(read, source.table, main, t, importing)
            inside &= covered
        values[name] = read
    cut = int((~inside).sum())
    if not cut:
        return t, importing.to_joint_side(values), ()
    covered_by_all = {name: x[inside] for name, x in values.items()}
    note = f"rows cut outside the time of the other files: {cut}"
    return t[inside], importing.to_joint_side(covered_by_all), (note,)


def _missing_channel(
    name: str,
    channel: Channel,
    log: Log,
    main: LogTable,
    arm: NominalArm,
    left_out: tuple[str, ...],
) -> InputError:
    """The error on a channel that a recording of a case has to hold; ``left_out`` says why it was not taken."""
    if left_out:
        return InputError(
            left_out[0],
            f"name the column and how to join it in the case's import section, or say {name}: null to do without",
            file=log.path,
        )
    tables = {table.name: table.table for table in log.tables}
    held = main.table if main.name in tables else next(iter(tables.values()))
    wanted = channel.names(arm.joints)[0]
    if layout_of_kind(main.kind) is not None and not channel.placed:
        wanted = f"for {name} of all joints"
    null = f"say {name}: null to do without"
    error = held.lacks(
        wanted, f"name the column in the case's import section, or {null}"
    )
    return error.at(log.path)


def _missing_file(
    name: str,
    file: str | None,
    logs: Mapping[str | None, Log],
    importing: Import,
) -> InputError:
    """The error on a channel, or the time, whose file an entry does not give."""
    return InputError(
        f"comes from the file {file}, an entry holds {', '.join(map(str, logs))}",
        "give each entry a file for every label of the import section",
        file=importing.source,
        where=f"field import.{name}",
    )
