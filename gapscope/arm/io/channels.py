"""Channels of a log: entries of the import section, patterns of column names, units, transmission."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from gapscope.arm.errors import InputError
from gapscope.arm.io.channel_entry import NORMALISED, UNITS, Channel, with_sign
from gapscope.arm.io.column_pattern import joints_in, name_of
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.layouts import LAYOUTS, LEROBOT, Place, layout_of_kind
from gapscope.arm.io.plausibility import check_rate, check_runs_forward
from gapscope.arm.io.table import Log, LogTable, Table
from gapscope.arm.nominal import NominalArm

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
    values = (
        table.lists(names[0], arm.n_joints)
        if listed
        else np.column_stack([table.numbers(name) for name in names])
    )
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


# Where a log holds each channel: the table, and the columns of the arm's joints in it.


MIN_OVERLAP = 0.5
"""Share of the motion that a topic must cover to be joined although nobody named it [1]."""

_KINDS = [layout.kind for layout in LAYOUTS if layout.kind]


@dataclass(frozen=True)
class Source:
    """Where one channel comes from.

    Attributes:
        table: that holds it.
        channel: with the columns in that table.
        by_order: the log's names of the joints, if they are taken for the arm's by their order alone.
    """

    table: Table
    channel: Channel
    by_order: tuple[str, ...] = ()


@dataclass(frozen=True)
class Locator:
    """Finds the channels of an arm in the tables of its logs.

    Attributes:
        logs: by the label of the file.
        importing: what the case says about them.
        arm: whose joints are wanted.
    """

    logs: Mapping[str | None, Log]
    importing: Import
    arm: NominalArm

    def positions(self) -> tuple[LogTable, Source, tuple[str, ...]]:
        """The table with the positions, which all others are joined to; and notes.

        Raises:
            InputError: no table holds them for all joints, or several do.
        """
        channel = self.importing.channels["q"]
        assert channel is not None
        log = self.logs[channel.file]
        pool = _named_tables(log, channel.topic or self.importing.topic)
        if len(pool) == 1 and layout_of_kind(pool[0].kind) is None:
            # a column that is missing is named when it is read
            source = self.source(pool[0], "q", channel)
            source = source or Source(pool[0].table, channel)
            return pool[0], source, self._notes(source, ())
        # joint states before the state of a controller
        for kind in dict.fromkeys(sorted((t.kind for t in pool), key=_rank)):
            tables = [table for table in pool if table.kind == kind]
            found = [(table, self.source(table, "q", channel)) for table in tables]
            full = [(table, source) for table, source in found if source is not None]
            names = list(dict.fromkeys(table.name for table, _ in full))
            if len(names) > 1:
                raise _several(log, names, "q")
            if full:
                table, source = max(full, key=lambda pair: len(pair[0].table))
                partial = [t for t in tables if t.name == table.name and t is not table]
                return table, source, self._notes(source, partial)
        raise self._no_positions(log, pool, channel)

    def other(
        self, name: str, channel: Channel, main: LogTable
    ) -> tuple[Source | None, tuple[str, ...]]:
        """Where a channel beside q is: by preference in the table of q, else in another of its file; and notes.

        Args:
            name: of the channel.
            channel: what the case says about it.
            main: the table of q.

        Raises:
            InputError: the case names a topic that is not there, or a column that several topics have.
        """
        log = self.logs[channel.file]
        tables: Sequence[LogTable] = log.tables
        if channel.topic:
            tables = _named_tables(log, channel.topic)
        tables = sorted(tables, key=lambda t: (t is not main, _rank(t.kind)))
        found = [(table, self.source(table, name, channel)) for table in tables]
        whole = [(table, source) for table, source in found if source is not None]
        if not whole:
            return None, ()
        table, source = whole[0]
        if table is main:
            return source, ()
        topics = list(dict.fromkeys(t.name for t, _ in whole if t.kind == table.kind))
        if channel.named and len(topics) > 1:
            raise _several(log, topics, name)
        if channel.named:
            return source, ()
        if len(topics) > 1:
            return None, (f"{name} left out: on several topics, {', '.join(topics)}",)
        names = source.channel.names(self.arm.joints)
        doubt = _doubt(source, main.table, names, self.importing.time.column or "t")
        if doubt:
            return None, (f"{name} of {table.name} left out: {doubt}",)
        return source, (f"{name} from {table.name}",)

    def source(self, table: LogTable, name: str, channel: Channel) -> Source | None:
        """The channel in a table, or ``None`` if the table has nothing of it."""
        layout = layout_of_kind(table.kind)
        if layout is None or channel.placed:
            return self._placed(table, channel)
        sources = [
            self._known(table, place, channel) for place in layout.places.get(name, ())
        ]
        return next((source for source in sources if source is not None), None)

    def _placed(self, table: LogTable, channel: Channel) -> Source | None:
        """The channel in the columns that the case names, perhaps not all of them."""
        by_order: tuple[str, ...] = ()
        if isinstance(channel.column, str) and "{joint}" in channel.column:
            joints, by_order = self._joints(table, channel.column)
            channel = replace(channel, column=tuple(channel.names(joints)))
        names = [table.table.named(name) for name in channel.names(self.arm.joints)]
        if not any(name in table.table.columns for name in names):
            return None
        return Source(table.table, channel, by_order)

    def _known(self, table: LogTable, place: Place, channel: Channel) -> Source | None:
        """The channel in the columns of a known layout, for all joints."""
        # a current is no torque before the case gives the motors' constants
        if place.unit and place.unit != channel.unit:
            return None
        joints, by_order = self._joints(table, place.column)
        names = tuple(Channel(place.column).names(joints))
        if not all(name in table.table.columns for name in names):
            return None
        return Source(table.table, replace(channel, column=names), by_order)

    def _joints(
        self, table: LogTable, pattern: str
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The log's names of the arm's joints, in the arm's order; and again if their order alone says so."""
        if self.importing.joints is not None:
            return self.importing.joints, ()
        arm = self.arm
        names = tuple(joints_in(pattern, table.table.columns))
        foreign = not set(names) & set(arm.joints) and len(names) == arm.n_joints
        if foreign and layout_of_kind(table.kind) is not None:
            return names, names
        return arm.joints, ()

    def _notes(self, source: Source, partial: Sequence[LogTable]) -> tuple[str, ...]:
        """What was assumed and left out for the positions."""
        notes = source.table.notes
        if source.by_order:
            names, joints = source.by_order, self.arm.joints
            text = (
                f"joints are matched by order: {names[0]} .. {names[-1]} in the log are "
                f"{joints[0]} .. {joints[-1]} of the arm"
            )
            notes = (text, *notes)
        left_out = sum(len(table.table) for table in partial)
        if left_out:
            text = f"joint states left out that lack a joint of the arm: {left_out}"
            notes = (*notes, text)
        return notes

    def _no_positions(
        self, log: Log, pool: Sequence[LogTable], channel: Channel
    ) -> InputError:
        """The error on a log of several tables, none of which has the positions."""
        for table in pool:
            layout = layout_of_kind(table.kind)
            place = layout and layout.place("q", table.table)
            if not place or channel.placed:
                continue
            names = place.joints(table.table)
            wanted = ", ".join(self.importing.joints or self.arm.joints)
            lacks = f"no message of {table.name} holds all of the joints {wanted}"
            return InputError(
                f"{lacks}; the first holds {', '.join(names)}",
                "name the log's joints, in the arm's order, in joints: of the import section",
                file=log.path,
            )
        columns = [f"{t.name} ({', '.join(list(t.table.columns)[:8])})" for t in pool]
        return InputError(
            f"has no joint positions; it has {', '.join([*columns, *log.unread]) or 'nothing'}",
            "record the topic of the joint states, or name topic and column in import: q",
            file=log.path,
        )


def _rank(kind: str) -> int:
    return _KINDS.index(kind) if kind in _KINDS else -1


def _named_tables(log: Log, name: str | None) -> list[LogTable]:
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


def _doubt(source: Source, main: Table, names: Sequence[str], time: str) -> str:
    """Why a table that nobody named is not to be joined, or an empty text.

    Args:
        source: the channel in that table.
        main: the table of the positions.
        names: of the channel's columns.
        time: name of the column of time.
    """
    columns = source.table.columns
    missing = [name for name in names if name not in columns]
    if missing:
        return f"it has no column {missing[0]}"
    if time not in columns or time not in main.columns:
        rows = f"it has {len(source.table)} rows, the positions have {len(main)}"
        return f"{rows}, and not both have a column {time}"
    values = [columns[name] for name in names]
    if not np.isfinite(np.asarray(values, dtype=float)).all():
        return "it is not finite throughout"
    t, stamps = main.columns[time], columns[time]
    covered = float(np.mean((t >= stamps[0]) & (t <= stamps[-1])))
    return "" if covered >= MIN_OVERLAP else f"it covers {covered:.0%} of the motion"


# Angles of a LeRobot dataset in radians: it says nowhere whether it holds degrees or normalised positions.


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
