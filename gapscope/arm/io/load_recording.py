"""A recording from its log: rows evened, parts split, units of datasets, samples put right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_NUMBER
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
    noted,
    put_right,
    repeated_rows,
)
from gapscope.arm.io.table import (
    GAP_STEPS,
    Damage,
    Log,
    Table,
    damage,
    table_of_columns,
)
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


Part = tuple[Entry, dict[str, Any]]
"""One recording of an entry: its file, or files side by side, and the ``rows`` or ``episode`` of ``load_recording``."""


def parts_of(entry: Entry, importing: Import, use: str) -> list[Part]:
    """The recordings of an entry that may be fitted, or are held out.

    By default all of its rows, or all episodes of a dataset, are fitted and nothing is held out. An episode may also be
    named as a table is, in ``topic``.

    Args:
        entry: file, or files side by side.
        importing: the case's import section.
        use: ``fit`` or ``judge``.
    """
    default = (None,) if use == "fit" else ()
    if not (isinstance(entry, Path) and is_dataset(entry)):
        return [(entry, {"rows": rows}) for rows in importing.rows.get(use) or default]
    episodes: Sequence[int] = importing.episodes.get(use, ())
    if use == "fit":
        # a topic may also name one episode
        episodes = [
            episode
            for episode in episodes or dataset_episodes(entry)
            if importing.topic in (None, episode_name(episode))
        ]
    return [(entry, {"episode": episode}) for episode in episodes]


# A recording from its files: any of the formats, through the import section, with the checks a reader owes its user.


SAID_START = 1.0
"""A log whose first stamp is farther from 0 has a note that says so [s]."""
FROM_FIRST_ROW = "time is counted from the first row, whose stamp is {:.10g} s"


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
    reader = _Reader(path, arm, importing or Import(), episode)
    held = reader.tables(complete)
    # before rows are cut: time counts from the first row of the log
    begun = reader.first_stamp(held[0][0])
    if rows is not None:
        held = [
            # what is joined by time is cut by the time of the positions
            (x.part(*rows) if not k or reader.by_row(x) else x, channels)
            for k, (x, channels) in enumerate(held)
        ]
    # before anything is computed, so that messages name lines of the file
    held = reader.sound(held)
    main = held[0][0]
    t, values = reader.channels(reader.time(main, any_unit=any_unit), held)
    # read-only from here on, so that the recording shares them
    for series in (t, *values.values()):
        series.setflags(write=False)
    name = main.path.name
    # an episode of several is told by its name
    if is_dataset(main.path) and len(reader.log.tables) == 1:
        name += f" {reader.log.tables[0].name}"
    if rows is not None:
        name += f" rows {rows[0]}-{rows[1]}"
    series_and_notes: dict[str, Any] = values | {"notes": tuple(reader.notes)}
    recording = Recording(name, t, payload=payload, begun=begun, **series_and_notes)
    # first what a logger wrote twice: such rows hide that the others are even
    repeated, found = repeated_rows(t, recording.channels)
    if repeated.any() and not every_row:
        recording = noted(recording.part(~repeated), *found)
        # only with rows dropped: a log that lost none keeps its stamps
        even = even_stamps_of_rows(recording.t, recording.q)
        if even is not None:
            recording = noted(recording, EVENLY_TAKEN, t=even)
    # a part of the rows is warm from those before it: its time goes on from the first row of the log
    recording = replace(recording, t=recording.t - begun)
    if abs(begun) > SAID_START:
        recording = noted(recording, FROM_FIRST_ROW.format(begun))
    recording = put_right(recording, arm.per_radian, every_row=every_row)
    mend = reader.importing.mend
    if mend is not None:
        # its time was put right as the stamps were read
        mend = replace(mend, time_factor=1.0)
        if every_row:
            # without what leaves rows out: a late torque, and a reference that ended
            mend = replace(mend, torque_delay=0.0, torque_drift=0.0, pace=1.0)
        recording = mend(recording, arm)
    # after the mending: positions in their own unit and on their own side
    recording = noted(
        recording, *check_positions(recording, arm, main, any_unit=any_unit)
    )
    if every_row:
        return recording
    return noted(recording, *held_notes(recording), *step_notes(recording))


def recording_of_columns(
    name: str, columns: Mapping[str, np.ndarray], arm: NominalArm
) -> Recording:
    """One recording of ``arm`` from columns in memory, in the units of the case format, checked as a file is.

    Args:
        name: of the recording, for messages.
        columns: ``t``, ``q1..qn``, and if known ``tau1..``, ``dq1..``, ... , shape (N,) each.
        arm: the nominal arm.

    Raises:
        InputError: a column is missing, of another length, no number or implausible; names row and column.
    """
    table = table_of_columns(Path(name), columns, kind="columns")
    # any unit: arrays in memory are diagnosed for their set-up, too
    return load_recording(Log(table.path, "columns", (table,)), arm, any_unit=True)


_KINDS = [layout.kind for layout in LAYOUTS if layout.kind]

Held = list[tuple[Table, dict[str, Channel]]]
"""Tables with the channels that come from them, that of the positions first."""


class _Reader:
    """Reads one recording of an arm out of the tables of its logs.

    Args:
        path, arm, importing, episode: see ``load_recording``.

    Attributes:
        notes: what was assumed, noticed and left out.
        logs: by the label of the file.
        log: the one that holds the positions.
        importing: what the case says, or nothing of a file that is in the columns of the case format already.

    Raises:
        InputError: a file cannot be read, or the one with the positions is missing.
    """

    def __init__(
        self,
        path: str | Path | Log | Mapping[str, Path],
        arm: NominalArm,
        importing: Import,
        episode: int | None,
    ) -> None:
        self.arm, self.importing = arm, importing
        self.notes: list[str] = []
        label = importing.main_file
        files = dict(path) if isinstance(path, Mapping) else {label: path}
        self.logs = {key: _log(x, episode, importing) for key, x in files.items()}
        if label not in self.logs:
            raise self._fault(
                f"an entry holds the files {', '.join(map(str, files))}, but q comes from {label}",
                "recordings",
                LABELS,
            )
        self.log = self.logs[label]
        channel = importing.channels["q"]
        assert channel is not None
        # in the case format, unless the columns of the section are there too
        if len(self.log.tables) == 1:
            columns = self.log.tables[0].columns
            names = map(self.log.tables[0].named, channel.names(arm.joints))
            if "q1" in columns and not any(name in columns for name in names):
                self.importing = Import()
                self.notes.append(
                    "read in the columns of the case format, not by the import section"
                )

    def _fault(self, problem: str, field: str, remedy: str) -> InputError:
        """The error on a field of the case file."""
        file = self.importing.source
        return InputError(problem, remedy, file=file, where=f"field {field}")

    # --- where a log holds each channel: the table, and the columns of the arm's joints in it

    def tables(self, complete: bool) -> Held:
        """The tables that hold the channels that can be had.

        Raises:
            InputError: a channel that is needed is missing, or the unit of a dataset's positions is not stated.
        """
        main, q = self._positions()
        # small numbers may be degrees, radians or normalised alike
        if main.kind == LEROBOT and not q.unit:
            raise InputError(
                "a LeRobot dataset does not say whether its positions are degrees, radians or normalised",
                f"say which: import: {{q: {{unit: deg}}}}, rad or {NORMALISED}",
                file=self.importing.source or main.path,
                where="field import.q.unit",
            )
        by_table = {id(main): (main, {"q": self._calibrated("q", q)})}
        for name, channel in self.importing.channels.items():
            if channel is None or name == "q":
                continue
            # a torque is asked for by default, others only if the case names them
            required = complete and (channel.named or name == "tau")
            if channel.file not in self.logs:
                if required:
                    raise self._missing_file(name, channel.file)
                continue
            # notes from here on say why it was left out
            said = len(self.notes)
            found = self._other(name, channel, main)
            if found is None:
                if required:
                    raise self._missing_channel(name, channel, main, self.notes[said:])
                continue
            table, own = found
            if main.kind == LEROBOT:
                # units of other channels are known to the recording robot alone
                if not (own.named or name == "q_ref"):
                    continue
                # the reference of a dataset is its action, in the unit of the positions
                if name == "q_ref" and not own.unit:
                    factor = own.factor * UNITS.get(q.unit, 1.0)
                    own = replace(own, unit=q.unit, factor=factor)
            own = self._calibrated(name, own)
            # one table, several channels: it is joined once
            by_table.setdefault(id(table), (table, {}))[1][name] = own
        return self._timed(list(by_table.values()))

    def _positions(self) -> tuple[Table, Channel]:
        """The table with the positions, which all others are joined to, and their columns.

        Raises:
            InputError: no table holds them for all joints, or several do.
        """
        channel, log, joints = self.importing.channels["q"], self.log, self.arm.joints
        assert channel is not None
        pool = _named_tables(log, channel.topic or self.importing.topic)
        if len(pool) == 1 and layout_of_kind(pool[0].kind) is None:
            self.notes += pool[0].notes
            # a column that is missing is named when it is read
            return pool[0], self._columns(pool[0], "q", channel) or channel
        found = [(table, self._columns(table, "q", channel)) for table in pool]
        full = [(table, own) for table, own in found if own is not None]
        if not full:
            raise self._no_positions(pool, channel)
        # joint states before the state of a controller
        kind = min((table.kind for table, _ in full), key=_rank)
        full = [(table, own) for table, own in full if table.kind == kind]
        names = list(dict.fromkeys(table.name for table, _ in full))
        if len(names) > 1:
            raise _several(log, names, "q")
        # the same topic may give tables of several sets of joints: the longest
        table, own = max(full, key=lambda pair: len(pair[0]))
        if own.by_order:
            self.notes.append(
                f"joints are matched by order: {own.by_order[0]} .. {own.by_order[-1]} in the log are "
                f"{joints[0]} .. {joints[-1]} of the arm"
            )
        self.notes += table.notes
        alike = [x for x in pool if (x.name, x.kind) == (table.name, kind)]
        left_out = sum(map(len, alike)) - len(table)
        if left_out:
            self.notes.append(
                f"joint states left out that lack a joint of the arm: {left_out}"
            )
        return table, own

    def _other(
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
        log = self.logs[channel.file]
        tables = _named_tables(log, channel.topic or None)
        # the table of the positions needs no joining: it comes first
        tables = sorted(tables, key=lambda t: (t is not main, _rank(t.kind)))
        found = [(table, self._columns(table, name, channel)) for table in tables]
        whole = [(table, own) for table, own in found if own is not None]
        if not whole:
            return None
        table, own = whole[0]
        if table is main:
            return table, own
        topics = list(dict.fromkeys(t.name for t, _ in whole if t.kind == table.kind))
        if channel.named:
            if len(topics) > 1:
                raise _several(log, topics, name)
            return table, own
        # what nobody named is only joined if nothing speaks against it
        if len(topics) > 1:
            said = f"{name} left out: on several topics, {', '.join(topics)}"
        else:
            doubt = self._doubt(table, main, own)
            said = f"{name} of {table.name} left out: {doubt}" if doubt else ""
        self.notes.append(said or f"{name} from {table.name}")
        return None if said else (table, own)

    def _doubt(self, table: Table, main: Table, channel: Channel) -> str:
        """Why a table that nobody named for a channel is not to be joined to the positions; empty if nothing is."""
        names, time = channel.names(self.arm.joints), self.importing.time.column or "t"
        for name in names:
            if name not in table.columns:
                return f"it has no column {name}"
        if time not in table.columns or time not in main.columns:
            rows = f"it has {len(table)} rows, the positions have {len(main)}"
            return f"{rows}, and not both have a column {time}"
        if not np.isfinite([table.values(name) for name in names]).all():
            return "it is not finite throughout"
        t, stamps = main.columns[time], table.columns[time]
        # a table that covers a part of the motion would cut the recording to it
        inside = (t >= stamps[0]) & (t <= stamps[-1])
        if 2 * inside.sum() >= len(t):
            return ""
        return f"it covers {inside.mean():.0%} of the motion"

    def _columns(self, table: Table, name: str, channel: Channel) -> Channel | None:
        """The channel with its columns in a table, or ``None`` if the table has nothing of it.

        Of columns that the case names some may be missing; of a known layout those of all joints have to be there.
        """
        layout, column = layout_of_kind(table.kind), channel.column
        # columns of the case, else those of the known layout
        if layout is None or channel.placed:
            if isinstance(column, str) and "{joint}" in column:
                channel = self._of_pattern(table, column, channel)
            named = map(table.named, channel.names(self.arm.joints))
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
        joints = self.importing.joints or self.arm.joints
        by_order: tuple[str, ...] = ()
        there = tuple(joints_in(pattern, table.columns))
        # other names but as many: the joints of a log in their order
        foreign = not set(there) & set(joints) and len(there) == len(joints)
        known = layout_of_kind(table.kind) is not None
        if foreign and known and self.importing.joints is None:
            joints = by_order = there
        names = tuple(names_of(pattern, joints))
        return replace(channel, column=names, by_order=by_order)

    def _calibrated(self, name: str, channel: Channel) -> Channel:
        """A channel whose normalised positions are angles [rad], by the factor and offset of the arm's calibration.

        Raises:
            InputError: a calibration is missing or lacks a motor.
        """
        if channel.unit != NORMALISED:
            return channel
        calibration = self.importing.calibration
        if calibration is None:
            raise self._fault(
                "positions from -100 to 100 are no angles without the ranges of the joints",
                f"import.{name}.unit",
                "give the arm's calibration file, import: calibration: FILE.json, or record with use_degrees",
            )
        # motors of columns such as observation.state[elbow_flex.pos]
        columns = [column.rpartition("[")[2] for column in channel.column]
        motors = [column.rstrip("]").removesuffix(".pos") for column in columns]
        missing = [motor for motor in motors if motor not in calibration]
        if missing:
            raise self._fault(
                f"the calibration has no motor {missing[0]}; it has {', '.join(calibration)}",
                "import.calibration",
                "name the joints as the dataset does in joints: of the import section",
            )
        factor, offset = np.array([calibration[motor] for motor in motors]).T
        return replace(channel, factor=channel.factor * factor, offset=offset)

    def _timed(self, held: Held) -> Held:
        """The tables, that of the positions with the time of another file as a column, if the case says so.

        Raises:
            InputError: the entry has no such file, or it has other rows.
        """
        label, column = self.importing.time.file, self.importing.time.column
        if label is None or label == self.importing.main_file or column is None:
            return held
        if label not in self.logs:
            raise self._missing_file("time", label)
        (main, channels), *others = held
        other = self.logs[label].tables[0]
        if len(other) != len(main):
            raise _other_rows(other, main, "give a file of the time with the same rows")
        # a column of one more name: the cells of another file, row by row
        name = f"{column} of {other.path.name}"
        timed = replace(main, columns={**main.columns, name: other.cells(column)})
        time = replace(self.importing.time, column=name)
        self.importing = replace(self.importing, time=time)
        return [(timed, channels), *others]

    def _missing_channel(
        self, name: str, channel: Channel, main: Table, left_out: Sequence[str]
    ) -> InputError:
        """The error on a channel that a recording of a case has to hold; ``left_out`` says why it was not taken."""
        log, null = self.logs[channel.file], f"say {name}: null to do without"
        if left_out:
            return InputError(
                left_out[0],
                f"name the column and how to join it in the case's import section, or {null}",
                file=log.path,
            )
        table = main if main.name in log.names else log.tables[0]
        wanted = channel.names(self.arm.joints)[0]
        if layout_of_kind(main.kind) is not None and not channel.placed:
            wanted = f"for {name} of all joints"
        remedy = f"name the column in the case's import section, or {null}"
        return table.lacks(wanted, remedy).at(log.path)

    def _missing_file(self, name: str, file: str | None) -> InputError:
        """The error on a channel, or the time, whose file an entry does not give."""
        said = f"comes from the file {file}, an entry holds {', '.join(map(str, self.logs))}"
        return self._fault(said, f"import.{name}", LABELS)

    def _no_positions(self, pool: Sequence[Table], channel: Channel) -> InputError:
        """The error on a log of several tables, none of which has the positions."""
        for table in pool:
            layout = layout_of_kind(table.kind)
            place = layout and layout.place("q", table)
            if place and not channel.placed:
                names = ", ".join(joints_in(place.column, table.columns))
                wanted = ", ".join(self.importing.joints or self.arm.joints)
                return InputError(
                    f"no message of {table.name} holds all of the joints {wanted}; the first holds {names}",
                    "name the log's joints, in the arm's order, in joints: of the import section",
                    file=self.log.path,
                )
        columns = [f"{t.name} ({', '.join(list(t.columns)[:8])})" for t in pool]
        there = ", ".join([*columns, *self.log.unread]) or "nothing"
        return InputError(
            f"has no joint positions; it has {there}",
            "record the topic of the joint states, or name topic and column in import: q",
            file=self.log.path,
        )

    # --- rows, time and channels of the tables

    def sound(self, held: Held) -> Held:
        """The tables without rows that cannot be read; those that are joined by row lose the same.

        Raises:
            InputError: there are too many.
        """
        main, time = held[0][0], self.importing.time.column
        found: list[tuple[Damage, bool]] = []
        for table, channels in held:
            columns = [
                name
                for each in channels.values()
                for name in each.names(self.arm.joints)
            ]
            joined = self.by_row(table) and len(table) == len(main)
            found.append((damage(table, columns, time), table is main or joined))
        # by row: a row that one of them lacks is lost to all
        shared = reduce(or_, (own for own, joined in found if joined))
        sound: Held = []
        # what is joined by time may lose rows of its own
        for (table, channels), (own, joined) in zip(held, found, strict=True):
            lost = shared if joined else own
            said = lost.notes(table)
            if table is main or not joined:
                self.notes += said
            sound.append((table.some(lost.sound) if said else table, channels))
        return sound

    def first_stamp(self, table: Table) -> float:
        """Time of the first row of a log that has one [s]; 0 if none has."""
        column, first = self.importing.time.column, [0]
        if column is not None:
            column = table.named(column)
            if column not in table.columns:
                return 0.0
            # rows at the beginning may be cut or empty
            usable = table.sizes(column) <= LARGEST_NUMBER
            first = np.flatnonzero(usable)[:1].tolist()
        for row in first:
            with suppress(InputError):
                return float(self._stamps(table.part(row, row))[0])
        return 0.0

    def time(self, table: Table, *, any_unit: bool = False) -> np.ndarray:
        """Time of each row [s], shape (N,).

        Raises:
            InputError: the column is missing or no number, jumps back, or has an implausible rate.
        """
        t, column = self._stamps(table), self.importing.time.column or "time"
        check_runs_forward(t, table, column)
        check_rate(t, table, column, any_unit=any_unit)
        return t

    def _stamps(self, table: Table) -> np.ndarray:
        """Time of each row [s], shape (N,), whatever it holds.

        Raises:
            InputError: the column is missing or no number.
        """
        time, rows = self.importing.time, table.row_numbers
        count = np.asarray(rows) if time.column is None else table.numbers(time.column)
        t = count / time.rate if time.rate is not None else count * time.factor
        # stamps of some files alone may be wrong, which the mending names
        mend = self.importing.mend
        if mend is None or (mend.files and table.path.name not in mend.files):
            return t
        return t * mend.time_factor

    def by_row(self, table: Table) -> bool:
        """Whether a table is joined row by row: topics have times of their own, files usually the same rows."""
        if self.importing.join is None:
            return table.place_kind != "message"
        return self.importing.join == "row"

    def channels(
        self, t: np.ndarray, held: Held
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Time [s], (N,), and channels in SI units on the joint side, (N, n) each, where all tables have them."""
        values: dict[str, np.ndarray] = {}
        main = held[0][0]
        # the rows that all tables cover
        inside = np.ones(len(main), dtype=bool)
        for table, channels in held:
            for name, channel in channels.items():
                own = self._channel(table, channel)
                if table is not main:
                    own, covered = self._joined(own, table, main, t)
                    inside &= covered
                values[name] = own
        values = {name: values[name] for name in CHANNELS if name in values}
        if not inside.all():
            cut = int((~inside).sum())
            self.notes.append(f"rows cut outside the time of the other files: {cut}")
            t, values = t[inside], {name: x[inside] for name, x in values.items()}
        return t, self.importing.to_joint_side(values)

    def _channel(self, table: Table, channel: Channel) -> np.ndarray:
        """A channel in SI units, shape (N, n).

        Raises:
            InputError: a column is missing, a cell is no finite number, or the table has columns for more joints than
                the arm.
        """
        arm, names = self.arm, channel.names(self.arm.joints)
        # cells that hold lists: one column for all joints
        listed = len(names) == 1 and arm.n_joints > 1
        if listed:
            values = table.numbers(names[0], arm.n_joints)
        else:
            values = np.column_stack([table.numbers(name) for name in names])
        if channel.sign_bit is not None:
            # whole numbers with a sign bit are never below zero
            if (values < 0).any():
                raise InputError(
                    f"{', '.join(names)}: negative numbers have their sign already",
                    "take sign_bit: out of the case's import section",
                    file=table.path,
                )
            values = with_sign(values, channel.sign_bit)
        # a pattern that also names a joint beyond the last one: another arm
        pattern = "" if listed or isinstance(channel.column, tuple) else channel.column
        surplus = name_of(pattern, arm.n_joints, "")
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

    def _joined(
        self, values: np.ndarray, table: Table, main: Table, t: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """A channel of ``table`` at the rows of ``main``, (N, n), and which of those rows it covers, (N,).

        Args:
            values: the channel at the rows of ``table``, (M, n).
            table: the table that it comes from.
            main: the table that holds q.
            t: time of the rows of ``main`` [s], (N,).

        Raises:
            InputError: row by row, and the files differ in length; or by time, and they do not overlap.
        """
        if self.by_row(table):
            if len(table) != len(main):
                raise _other_rows(
                    table,
                    main,
                    "give files with the same rows, or join: interpolate or hold and a time column in each",
                )
            return values, np.ones(len(main), dtype=bool)
        if table.place_kind == "message":
            # the time of messages is in s whatever their rate
            time = self._stamps(table)
            check_runs_forward(time, table, self.importing.time.column or "time")
        else:
            time = self.time(table)
        # a value that is held reaches beyond the last stamp, a curve does not
        covered = (t >= time[0]) & ((t <= time[-1]) | (self.importing.join == "hold"))
        if not covered.any():
            raise InputError(
                f"does not overlap in time with {main.path.name}: {time[0]:.6g} to {time[-1]:.6g} s, "
                f"against {t[0]:.6g} to {t[-1]:.6g} s",
                "give both files the same clock",
                file=table.path,
            )
        if self.importing.join == "hold":
            # before the first of its stamps nothing is held: those rows are cut
            return values[np.searchsorted(time[1:], t, side="right")], covered
        # straight lines would look like the set points of a slow controller; PCHIP does not overshoot steps
        different = np.r_[True, np.diff(time) > 0]
        curve = PchipInterpolator(time[different], values[different])
        return curve(np.clip(t, time[0], time[-1])), covered


LABELS = "give each entry a file for every label of the import section"
"""What to do about an entry that lacks a file."""


def _log(file: str | Path | Log, episode: int | None, importing: Import) -> Log:
    """A file as a log; of a dataset one episode, or those that the case names."""
    if isinstance(file, Log):
        return file
    path = Path(file)
    if not is_dataset(path):
        return open_log(path)
    # of parts that are asked for one by one, only that episode is read
    named = sum(importing.episodes.values(), ()) or None
    return read_dataset(path, named if episode is None else [episode])


def _rank(kind: str) -> int:
    return _KINDS.index(kind) if kind in _KINDS else -1


def _named_tables(log: Log, name: str | None) -> list[Table]:
    """The tables of a topic; of all topics if none is named."""
    found = [table for table in log.tables if name in (None, table.name)]
    if name is not None and not found:
        there = ", ".join([*log.names, *log.unread]) or "nothing"
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


def _other_rows(table: Table, main: Table, remedy: str) -> InputError:
    said = f"has {len(table)} rows, {main.path.name} has {len(main)}"
    return InputError(said, remedy, file=table.path)


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
        for one in out:
            # by the clock of both
            later = other.begun - one.begun
            step = later + other.t[0] - one.t[-1]
            # a recorder begins the next file within a few periods
            if 0.0 < step <= GAP_STEPS / one.rate:
                out[after] = replace(other, t=other.t + later, begun=one.begun)
                break
    return out
