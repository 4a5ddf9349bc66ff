"""A recording from its log: rows evened, parts split, units of datasets, samples put right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.lerobot import (
    dataset_episodes,
    episode_name,
    is_dataset,
    read_dataset,
)
from gapscope.arm.io.import_section import NORMALISED, Channel, Import
from gapscope.arm.io.layouts import (
    LAYOUTS,
    LEROBOT,
    UNITS,
    joints_in,
    layout_of_kind,
    name_of,
    names_of,
    with_sign,
)
from gapscope.arm.io.log import open_log
from gapscope.arm.io.plausibility import (
    EVENLY_TAKEN,
    check_positions,
    check_rate,
    check_runs_forward,
    even_stamps_of_rows,
    put_right,
    repeated_rows,
    without_rows,
)
from gapscope.arm.io.table import GAP_STEPS, Log, Table, damage
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import (
    CHANNELS,
    Recording,
    held_notes,
    step_notes,
)

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
    if not (isinstance(entry, Path) and is_dataset(entry)):
        return [Part(entry, rows) for rows in importing.fit or (None,)]
    topic = importing.topic
    episodes = importing.fit_episodes or dataset_episodes(entry)
    named = [k for k in episodes if topic in (None, episode_name(k))]
    return [Part(entry, episode=episode) for episode in named]


def judged_parts(entry: Entry, importing: Import) -> list[Part]:
    """The recordings of an entry that are held out: none by default."""
    if isinstance(entry, Path) and is_dataset(entry):
        return [Part(entry, episode=episode) for episode in importing.judge_episodes]
    return [Part(entry, rows) for rows in importing.judge]


# A recording from its files: any of the formats, through the import section, with the checks a reader owes its user.


SAID_START = 1.0
"""A log whose first stamp is farther from 0 has a note that says so [s]."""
FROM_FIRST_ROW = "time is counted from the first row, whose stamp is {:.10g} s"
LABELS = "give each entry a file for every label of the import section"
"""What to do about an entry that lacks a file."""

Sources = dict[str, tuple[Table, Channel]]
"""Where the channels come from, by name: a table and the columns in it."""
Held = list[tuple[Table, dict[str, Channel]]]
"""The same by table, that of the positions first."""


def load_recording(
    path: str | Path | Log | Mapping[str, Path],
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
        path: file or folder of any format of ``open_log``, or a log that was read already; or the files side by side by
            label.
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
    label = importing.main_file
    files = dict(path) if isinstance(path, Mapping) else {label: path}
    logs = {key: _log(file, episode, importing) for key, file in files.items()}
    if label not in logs:
        raise InputError(
            f"an entry holds the files {', '.join(map(str, logs))}, but q comes from {label}",
            LABELS,
            file=importing.source,
            where="field recordings",
        )
    notes: list[str] = []
    importing = _fitting(importing, logs[label], arm, notes)
    held = _tables(logs, arm, importing, complete, notes)
    held, importing = _timed(held, logs, importing)
    begun = _first_stamp(held[0][0], importing)
    if rows is not None:
        held = [
            # what is joined by time is cut by the time of the positions
            (x.part(*rows) if not k or by_row(x, importing) else x, channels)
            for k, (x, channels) in enumerate(held)
        ]
    held = _sound(held, arm, importing, notes)
    main = held[0][0]
    t = read_time(main, importing, any_unit=any_unit)
    t, values = _channels(t, held, arm, importing, notes)
    if not every_row:
        repeated, found = repeated_rows(t, values)
        t, values = without_rows(repeated, t, values)
        notes += found
        even = even_stamps_of_rows(t, values["q"]) if repeated.any() else None
        if even is not None:
            t = even
            notes.append(EVENLY_TAKEN)
    # a part of the rows is warm from those before it: its time goes on from the first row of the log
    t = t - begun
    if abs(begun) > SAID_START:
        notes.append(FROM_FIRST_ROW.format(begun))
    t, values, found = put_right(t, values, arm.per_radian, every_row=every_row)
    notes += found
    # read-only from here on, so that the recording shares them
    for series in (t, *values.values()):
        series.setflags(write=False)
    name = main.path.name
    if is_dataset(main.path) and len(logs[label].tables) == 1:
        name += f" {logs[label].tables[0].name}"
    if rows is not None:
        name += f" rows {rows[0]}-{rows[1]}"
    channels: dict[str, Any] = values
    recording = Recording(name, t, payload=payload, begun=begun, **channels)
    if importing.mend is not None:
        mend = importing.mend.of_right_time
        recording = (mend.of_every_row if every_row else mend)(recording, arm)
    notes += check_positions(recording, arm, main, any_unit=any_unit)
    if not every_row:
        notes += held_notes(recording) + step_notes(recording)
    return replace(recording, notes=tuple(notes))


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
    table = Table(Path(name), columns, range(1, length + 1), kind="columns")
    return load_recording(Log(table.path, "columns", (table,)), arm, any_unit=True)


def _log(file: str | Path | Log, episode: int | None, importing: Import) -> Log:
    """A file as a log; of a dataset one episode, or those that the case names."""
    if isinstance(file, Log):
        return file
    path = Path(file)
    if not is_dataset(path):
        return open_log(path)
    named = (*importing.fit_episodes, *importing.judge_episodes) or None
    return read_dataset(path, named if episode is None else [episode])


def _fitting(importing: Import, log: Log, arm: NominalArm, notes: list[str]) -> Import:
    """The import section, or none for a file that is in the columns of the case format already."""
    channel = importing.channels["q"]
    assert channel is not None
    if len(log.tables) != 1:
        return importing
    main = log.tables[0]
    named = any(main.named(name) in main.columns for name in channel.names(arm.joints))
    if named or "q1" not in main.columns:
        return importing
    notes.append("read in the columns of the case format, not by the import section")
    return Import()


def _tables(
    logs: Mapping[str | None, Log],
    arm: NominalArm,
    importing: Import,
    complete: bool,
    notes: list[str],
) -> Held:
    """The tables that hold the channels that can be had.

    Raises:
        InputError: a channel that is needed is missing.
    """
    search = _Search(logs, importing, arm, notes)
    main, q = search.positions()
    sources: Sources = {"q": (main, q)}
    for name, channel in importing.channels.items():
        if channel is None or name == "q":
            continue
        required = complete and (channel.named or name == "tau")
        if channel.file not in logs:
            if required:
                raise _missing_file(name, channel.file, logs, importing)
            continue
        said = len(notes)
        found = search.other(name, channel, main)
        if found is not None:
            sources[name] = found
        elif required:
            log, why = logs[channel.file], notes[said:]
            raise _missing_channel(name, channel, log, main, arm, why)
    held: dict[int, tuple[Table, dict[str, Channel]]] = {}
    for name, (table, channel) in in_radians(sources, importing).items():
        held.setdefault(id(table), (table, {}))[1][name] = channel
    return list(held.values())


def _timed(
    held: Held, logs: Mapping[str | None, Log], importing: Import
) -> tuple[Held, Import]:
    """The tables, that of the positions with the time of another file as a column, if the case says so.

    Raises:
        InputError: the entry has no such file, or it has other rows.
    """
    label, column = importing.time.file, importing.time.column
    if label is None or label == importing.main_file or column is None:
        return held, importing
    if label not in logs:
        raise _missing_file("time", label, logs, importing)
    (main, channels), *others = held
    other = logs[label].tables[0]
    if len(other) != len(main):
        raise InputError(
            f"has {len(other)} rows, {main.path.name} has {len(main)}",
            "give a file of the time with the same rows",
            file=other.path,
        )
    name = f"{column} of {other.path.name}"
    timed = replace(main, columns={**main.columns, name: other.cells(column)})
    time = replace(importing.time, column=name)
    return [(timed, channels), *others], replace(importing, time=time)


def _first_stamp(table: Table, importing: Import) -> float:
    """Time of the first row of a log that has one [s]; 0 if none has."""
    for row in range(len(table)):
        with suppress(InputError):
            return float(stamps(table.part(row, row), importing)[0])
    return 0.0


def _sound(held: Held, arm: NominalArm, importing: Import, notes: list[str]) -> Held:
    """The tables without rows that cannot be read; those that are joined by row lose the same.

    Raises:
        InputError: there are too many.
    """
    main, time = held[0][0], importing.time.column
    found, beside = [], []
    for table, channels in held:
        columns = [
            name for channel in channels.values() for name in channel.names(arm.joints)
        ]
        found.append(damage(table, columns, time))
        same_rows = by_row(table, importing) and len(table) == len(main)
        beside.append(table is main or same_rows)
    shared = found[0]
    for own, joined in zip(found[1:], beside[1:], strict=True):
        shared = shared | own if joined else shared
    sound: Held = []
    for (table, channels), own, joined in zip(held, found, beside, strict=True):
        lost = shared if joined else own
        said = lost.notes(table)
        if table is main or not joined:
            notes += said
        sound.append((table.some(lost.sound) if said else table, channels))
    return sound


def _channels(
    t: np.ndarray,
    held: Held,
    arm: NominalArm,
    importing: Import,
    notes: list[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time [s], (N,), and channels in SI units on the joint side, (N, n) each, where all tables have them."""
    values: dict[str, np.ndarray] = {}
    main = held[0][0]
    inside = np.ones(len(main), dtype=bool)
    for table, channels in held:
        for name, channel in channels.items():
            values[name] = read_channel(table, channel, arm)
            if table is not main:
                joined = join(values[name], table, main, t, importing)
                values[name], covered = joined
                inside &= covered
    values = {name: values[name] for name in CHANNELS if name in values}
    if not inside.all():
        cut = int((~inside).sum())
        notes.append(f"rows cut outside the time of the other files: {cut}")
        t, values = without_rows(~inside, t, values)
    return t, importing.to_joint_side(values)


def _missing_channel(
    name: str,
    channel: Channel,
    log: Log,
    main: Table,
    arm: NominalArm,
    left_out: Sequence[str],
) -> InputError:
    """The error on a channel that a recording of a case has to hold; ``left_out`` says why it was not taken."""
    null = f"say {name}: null to do without"
    if left_out:
        return InputError(
            left_out[0],
            f"name the column and how to join it in the case's import section, or {null}",
            file=log.path,
        )
    table = main if main.name in log.names else log.tables[0]
    wanted = channel.names(arm.joints)[0]
    if layout_of_kind(main.kind) is not None and not channel.placed:
        wanted = f"for {name} of all joints"
    remedy = f"name the column in the case's import section, or {null}"
    return table.lacks(wanted, remedy).at(log.path)


def _missing_file(
    name: str, file: str | None, logs: Mapping[str | None, Log], importing: Import
) -> InputError:
    """The error on a channel, or the time, whose file an entry does not give."""
    return InputError(
        f"comes from the file {file}, an entry holds {', '.join(map(str, logs))}",
        LABELS,
        file=importing.source,
        where=f"field import.{name}",
    )


# Where a log holds each channel: the table, and the columns of the arm's joints in it.


MIN_OVERLAP = 0.5
"""Share of the motion that a topic must cover to be joined although nobody named it [1]."""

_KINDS = [layout.kind for layout in LAYOUTS if layout.kind]


class _Search:
    """Finds the channels of an arm in the tables of its logs.

    Args:
        logs: by the label of the file.
        importing: what the case says about them.
        arm: whose joints are wanted.
        notes: what was assumed and left out is added to them.
    """

    def __init__(
        self,
        logs: Mapping[str | None, Log],
        importing: Import,
        arm: NominalArm,
        notes: list[str],
    ) -> None:
        self._logs, self._importing, self._arm = logs, importing, arm
        self._notes = notes

    def positions(self) -> tuple[Table, Channel]:
        """The table with the positions, which all others are joined to, and their columns.

        Raises:
            InputError: no table holds them for all joints, or several do.
        """
        channel = self._importing.channels["q"]
        assert channel is not None
        log = self._logs[channel.file]
        pool = _named_tables(log, channel.topic or self._importing.topic)
        if len(pool) == 1 and layout_of_kind(pool[0].kind) is None:
            self._notes.extend(pool[0].notes)
            # a column that is missing is named when it is read
            return pool[0], self._columns(pool[0], "q", channel) or channel
        found = [(table, self._columns(table, "q", channel)) for table in pool]
        full = [(table, own) for table, own in found if own is not None]
        if not full:
            raise self._no_positions(log, pool, channel)
        # joint states before the state of a controller
        kind = min((table.kind for table, _ in full), key=_rank)
        full = [(table, own) for table, own in full if table.kind == kind]
        names = list(dict.fromkeys(table.name for table, _ in full))
        if len(names) > 1:
            raise _several(log, names, "q")
        table, own = max(full, key=lambda pair: len(pair[0]))
        joints = self._arm.joints
        if own.by_order:
            self._notes.append(
                f"joints are matched by order: {own.by_order[0]} .. {own.by_order[-1]} in the log are "
                f"{joints[0]} .. {joints[-1]} of the arm"
            )
        self._notes.extend(table.notes)
        alike = [x for x in pool if (x.name, x.kind) == (table.name, kind)]
        left_out = sum(map(len, alike)) - len(table)
        if left_out:
            self._notes.append(
                f"joint states left out that lack a joint of the arm: {left_out}"
            )
        return table, own

    def other(
        self, name: str, channel: Channel, main: Table
    ) -> tuple[Table, Channel] | None:
        """Where a channel beside q is: by preference in the table of q, else in another of its file.

        Args:
            name: of the channel.
            channel: what the case says about it.
            main: the table of q.

        Raises:
            InputError: the case names a topic that is not there, or a column that several topics have.
        """
        log = self._logs[channel.file]
        tables = _named_tables(log, channel.topic or None)
        tables = sorted(tables, key=lambda t: (t is not main, _rank(t.kind)))
        found = [(table, self._columns(table, name, channel)) for table in tables]
        whole = [(table, own) for table, own in found if own is not None]
        if not whole:
            return None
        table, own = whole[0]
        if table is main:
            return table, own
        topics = list(dict.fromkeys(t.name for t, _ in whole if t.kind == table.kind))
        if channel.named and len(topics) > 1:
            raise _several(log, topics, name)
        if channel.named:
            return table, own
        if len(topics) > 1:
            note = f"{name} left out: on several topics, {', '.join(topics)}"
            self._notes.append(note)
            return None
        names, time = own.names(self._arm.joints), self._importing.time.column or "t"
        doubt = _doubt(table, main, names, time)
        if doubt:
            self._notes.append(f"{name} of {table.name} left out: {doubt}")
            return None
        self._notes.append(f"{name} from {table.name}")
        return table, own

    def _columns(self, table: Table, name: str, channel: Channel) -> Channel | None:
        """The channel with its columns in a table, or ``None`` if the table has nothing of it.

        Of columns that the case names some may be missing; of a known layout those of all joints have to be there.
        """
        layout, column = layout_of_kind(table.kind), channel.column
        if layout is None or channel.placed:
            if isinstance(column, str) and "{joint}" in column:
                channel = self._of_pattern(table, column, channel)
            named = map(table.named, channel.names(self._arm.joints))
            return channel if any(each in table.columns for each in named) else None
        for place in layout.places.get(name, ()):
            own = self._of_pattern(table, place.column, channel)
            # a current is no torque before the case gives the motors' constants
            fits = not place.unit or place.unit == channel.unit
            if fits and all(each in table.columns for each in own.column):
                return own
        return None

    def _of_pattern(self, table: Table, pattern: str, channel: Channel) -> Channel:
        """The channel with the columns of a pattern, by the log's names of the arm's joints.

        Those are the case's, else the arm's; or, in a known layout, as many others that the log has in their order.
        """
        joints = self._importing.joints or self._arm.joints
        by_order: tuple[str, ...] = ()
        there = tuple(joints_in(pattern, table.columns))
        foreign = not set(there) & set(joints) and len(there) == len(joints)
        known = layout_of_kind(table.kind) is not None
        if foreign and known and self._importing.joints is None:
            joints = by_order = there
        names = tuple(names_of(pattern, joints))
        return replace(channel, column=names, by_order=by_order)

    def _no_positions(
        self, log: Log, pool: Sequence[Table], channel: Channel
    ) -> InputError:
        """The error on a log of several tables, none of which has the positions."""
        for table in pool:
            layout = layout_of_kind(table.kind)
            place = layout and layout.place("q", table)
            if not place or channel.placed:
                continue
            names = joints_in(place.column, table.columns)
            wanted = ", ".join(self._importing.joints or self._arm.joints)
            lacks = f"no message of {table.name} holds all of the joints {wanted}"
            return InputError(
                f"{lacks}; the first holds {', '.join(names)}",
                "name the log's joints, in the arm's order, in joints: of the import section",
                file=log.path,
            )
        columns = [f"{t.name} ({', '.join(list(t.columns)[:8])})" for t in pool]
        return InputError(
            f"has no joint positions; it has {', '.join([*columns, *log.unread]) or 'nothing'}",
            "record the topic of the joint states, or name topic and column in import: q",
            file=log.path,
        )


def _rank(kind: str) -> int:
    return _KINDS.index(kind) if kind in _KINDS else -1


def _named_tables(log: Log, name: str | None) -> list[Table]:
    """The tables of a topic; of all topics if none is named."""
    found = [table for table in log.tables if name in (None, table.name)]
    if name is not None and not found:
        there = ", ".join([*log.names, *log.unread])
        raise InputError(
            f"has no topic {name} about joints; it has {there}",
            "name one of these in topic: of the import section",
            file=log.path,
        )
    return found


def _several(log: Log, names: Sequence[str], channel: str) -> InputError:
    return InputError(
        f"has {channel} on several topics: {', '.join(names)}",
        "name one in topic: of the import section, or the episode in episodes: of a dataset",
        file=log.path,
    )


def _doubt(table: Table, main: Table, names: Sequence[str], time: str) -> str:
    """Why a table that nobody named is not to be joined, or an empty text.

    Args:
        table: that holds the channel.
        main: the table of the positions.
        names: of the channel's columns.
        time: name of the column of time.
    """
    missing = [name for name in names if name not in table.columns]
    if missing:
        return f"it has no column {missing[0]}"
    if time not in table.columns or time not in main.columns:
        rows = f"it has {len(table)} rows, the positions have {len(main)}"
        return f"{rows}, and not both have a column {time}"
    values = [table.columns[name] for name in names]
    if not np.isfinite(np.asarray(values, dtype=float)).all():
        return "it is not finite throughout"
    t, stamps = main.columns[time], table.columns[time]
    covered = float(np.mean((t >= stamps[0]) & (t <= stamps[-1])))
    return "" if covered >= MIN_OVERLAP else f"it covers {covered:.0%} of the motion"


# Angles of a LeRobot dataset in radians: it says nowhere whether it holds degrees or normalised positions.


def in_radians(sources: Sources, importing: Import) -> Sources:
    """The sources, normalised positions with the factor and offset of the arm's calibration.

    Of a LeRobot dataset the action is read as the reference, in the unit of the positions; other channels only if
    the case names them, as their units are known to the recording robot alone.

    Raises:
        InputError: the unit of a dataset's positions is not stated, or a calibration is missing or lacks a motor.
    """
    main, q = sources["q"]
    found: Sources = {}
    for name, (table, channel) in sources.items():
        if main.kind == LEROBOT:
            if not q.unit:
                raise InputError(
                    "a LeRobot dataset does not say whether its positions are degrees, radians or normalised",
                    f"say which: import: {{q: {{unit: deg}}}}, rad or {NORMALISED}",
                    file=importing.source or main.path,
                    where="field import.q.unit",
                )
            if not (channel.named or name == "q_ref"):
                continue
            if name == "q_ref" and not channel.unit:
                factor = channel.factor * UNITS.get(q.unit, 1.0)
                channel = replace(channel, unit=q.unit, factor=factor)
        if channel.unit == NORMALISED:
            channel = _calibrated(channel, name, importing)
        found[name] = table, channel
    return found


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
    # motors of columns such as observation.state[elbow_flex.pos]
    columns = [column.rpartition("[")[2] for column in channel.column]
    motors = [column.rstrip("]").removesuffix(".pos") for column in columns]
    missing = [motor for motor in motors if motor not in calibration]
    if missing:
        raise InputError(
            f"the calibration has no motor {missing[0]}; it has {', '.join(calibration)}",
            "name the joints as the dataset does in joints: of the import section",
            file=importing.source,
            where="field import.calibration",
        )
    factor, offset = np.array([calibration[motor] for motor in motors]).T
    return replace(channel, factor=channel.factor * factor, offset=offset)


# One channel out of the columns of a table, and onto the time of another table.


def read_time(table: Table, importing: Import, *, any_unit: bool = False) -> np.ndarray:
    """Time of each row [s], shape (N,).

    Raises:
        InputError: the column is missing or no number, jumps back, or has an implausible rate.
    """
    t, column = stamps(table, importing), importing.time.column or "time"
    check_runs_forward(t, table, column)
    check_rate(t, table, column, any_unit=any_unit)
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
    listed = len(names) == 1 and arm.n_joints > 1
    if listed:
        values = table.numbers(names[0], arm.n_joints)
    else:
        values = np.column_stack([table.numbers(name) for name in names])
    if channel.sign_bit is not None:
        if (values < 0).any():
            raise InputError(
                f"{', '.join(names)}: negative numbers have their sign already",
                "take sign_bit: out of the case's import section",
                file=table.path,
            )
        values = with_sign(values, channel.sign_bit)
    # a pattern that also names a joint beyond the last one: another arm
    surplus = ""
    if isinstance(channel.column, str) and not listed:
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


def by_row(table: Table, importing: Import) -> bool:
    """Whether a table is joined row by row: topics have times of their own, files usually the same rows."""
    if importing.join is None:
        return table.place_kind != "message"
    return importing.join == "row"


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
    if by_row(table, importing):
        if len(table) != len(main):
            raise InputError(
                f"has {len(table)} rows, {main.path.name} has {len(main)}",
                "give files with the same rows, or join: interpolate or hold and a time column in each",
                file=table.path,
            )
        return values, np.ones(len(main), dtype=bool)
    if table.place_kind == "message":
        # the time of messages is in s whatever their rate
        time = stamps(table, importing)
        check_runs_forward(time, table, importing.time.column or "time")
    else:
        time = read_time(table, importing)
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


# Logs in several files: what a recorder has split, by size or by time, goes on where the file before it ended.
#
# Time of such a file counts from the first row of the first one: friction that fades since the start of a recording
# goes on fading, and a force acts when it acts.


def joined_in_time(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, in their order; the time of those that go on where another one ended counts from its start."""
    out = list(recordings)
    # what came before a file has its final time by then
    for after in sorted(range(len(out)), key=lambda k: float(out[k].stamps[0])):
        other = out[after]
        ended = [one for one in out if _goes_on(one, other)]
        if ended:
            later = other.begun - ended[0].begun
            out[after] = replace(other, t=other.t + later, begun=ended[0].begun)
    return out


def _goes_on(one: Recording, other: Recording) -> bool:
    """Whether a recording begins where another one ended, by the clock of both."""
    step = (other.begun + other.t[0]) - (one.begun + one.t[-1])
    return bool(0.0 < step <= GAP_STEPS / one.rate)
