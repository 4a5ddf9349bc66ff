"""What is in logs: which columns are which channel, in which units, of which joints, and what looks wrong."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import wrap
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from jinja2 import Environment

from gapscope.arm.case import Case, load_case
from gapscope.arm.display import figures, marked
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.link_shapes import read_frames
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.layouts import (
    LEROBOT,
    layout_of,
    name_of,
)
from gapscope.arm.io.log import Log
from gapscope.arm.io.table import BEYOND, Table, without_damage
from gapscope.arm.joint_units import common_unit
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import SHEET_UNITS, NominalArm
from gapscope.arm.recording import (
    CHANNELS,
    Recording,
    resting,
    set_points,
    step_notes,
)
from gapscope.arm.robots import actuated_joints, load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.set_up import Remark, SetUp, fault_remark, look_at_set_up
from gapscope.diagnosis.setup_faults.clocks import find_stamps
from gapscope.diagnosis.setup_faults.references import exact_gains
from gapscope.diagnosis.thresholds import NO_TORQUE
from gapscope.effects.effect import SHEET
from gapscope.inspection.columns import (
    AMPERES,
    ChannelGuess,
    ColumnGroup,
    TimeGuess,
    channels_of_table,
    columns_by_values,
    first_of_each,
    guess_time,
    sorted_columns,
)
from gapscope.inspection.recordings import check_rest, remarks_on

# One table of a log with what its columns are taken for.


@dataclass(frozen=True)
class InspectedTable:
    """A table, its columns and what they are taken for.

    Attributes:
        log: that holds it.
        part: the table in the log.
        groups: its columns with one number for each joint.
        time: where the time stands.
        channels: every group of columns that may be a channel, the best first for each.
    """

    log: Log
    part: Table
    groups: tuple[ColumnGroup, ...]
    time: TimeGuess
    channels: tuple[ChannelGuess, ...]

    @property
    def by_values(self) -> bool:
        """Whether values tell what columns hold, their names being silent or missing."""
        return any(group.holds for group in self.groups) or self.part.unnamed

    @property
    def label(self) -> str:
        """File and topic, for messages."""
        return " ".join(filter(None, (self.log.path.name, self.part.name)))

    @property
    def shape(self) -> tuple[object, ...]:
        """What tables of several logs of one kind share: topic, and the columns taken for each channel."""
        first = first_of_each(self.channels).items()
        taken = ((name, x.group.pattern, x.group.labels) for name, x in first)
        return (self.part.name, *sorted(taken))

    def best(self, channel: str) -> ChannelGuess | None:
        """The first columns taken for a channel."""
        return first_of_each(self.channels).get(channel)

    def of_another_arm(self, taken: Collection[str], n_joints: int) -> str:
        """Positions beside the columns taken, if there are as many as the arm has joints, in words; else empty."""
        groups = [guess.group for guess in self.channels if guess.channel == "q"]
        every = [name for group in groups for name in group.names]
        beside = [name for name in every if name not in taken]
        # all of them taken, or too few for another arm: nothing to say
        if len(beside) < n_joints or len(beside) == len(every):
            return ""
        return f"it holds positions as of another arm, too: {span_of(beside)}"


def span_of(names: Sequence[str]) -> str:
    """The first and the last of some columns, in words."""
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def inspect_table(
    log: Log,
    part: Table,
    arm: NominalArm | None,
    *,
    named_by_file: bool = True,
    by_values: bool = False,
) -> InspectedTable:
    """A table of a log, with what its columns are taken for.

    Args:
        log: that holds it.
        part: the table.
        arm: the nominal arm, if it is known: columns may carry the names of its joints.
        named_by_file: whether the names of file and topic say what columns hold whose own names are silent.
        by_values: whether the values of columns say so, as they do for lack of names.
    """
    # broken rows first: a single text would make one of a column
    part = without_damage(part)
    context = f"{log.path.stem} {part.name}" if named_by_file else ""
    if by_values or part.unnamed:
        columns = columns_by_values(part, arm, context)
    else:
        columns = sorted_columns(part, () if arm is None else arm.joints)
    time = guess_time(columns, np.asarray(part.row_numbers), context)
    groups, _ = columns
    channels = channels_of_table(groups, layout_of(part), time, context)
    return InspectedTable(log, part, groups, time, tuple(channels))


# What a torque column can be, by the log alone: silent, unsigned, computed, or another column times a factor.


EXACT = 1e-3
"""Share of a column's deviation that rounding leaves if it is a multiple of another [1]; a measurement leaves more."""


def torque_facts(table: InspectedTable, torque: ChannelGuess) -> list[str]:
    """Sentences on one torque column of a table, each with its figures; empty if nothing strikes."""
    values = torque.group.values
    if not usable(values):
        return ["it holds cells that are no numbers, or beyond any torque"]
    silent = np.ptp(values, axis=0) == 0
    # nothing else can be said of a column that is silent on all joints
    if silent.all():
        return [f"it is {values[0, 0]:g} throughout: nothing was measured"]
    facts = []
    if silent.any():
        facts.append(f"it never changes on joint {marked(silent)}")
    # gravity may hold one joint on one side, hardly all of them throughout
    if (values >= 0).all():
        facts.append("it is never negative: a magnitude, whose sign is lost")
    return [*facts, *_multiples(torque, table.channels)]


def _computed(recording: Recording) -> Iterator[str]:
    """The gains of a torque that a control law computed."""
    # velocities that were not recorded count as zero: the law is asked for with both
    nothing = np.zeros_like(recording.q)
    known = {"dq": recording.dq, "dq_ref": recording.dq_ref}
    rates: dict[str, Any] = {
        name: nothing if x is None else x for name, x in known.items()
    }
    gains = exact_gains((replace(recording, **rates),))
    if gains is not None:
        kp, kd = map(figures, gains.T)
        yield (
            f"it is computed, not measured: kp (q_ref - q) + kd (dq_ref - dq) with kp {kp} and kd {kd}. "
            "As a command that is what it should be; whether the arm obeyed these gains, the log does not say"
        )


def _multiples(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """Columns that it is a multiple of, joint by joint."""
    values = torque.group.values
    for other in others:
        source = other.group.values
        if other is torque or source.shape != values.shape or not usable(source):
            continue
        power = (source**2).sum(axis=0)
        # least squares joint by joint: y = f x, f = x y / x x
        factors = (values * source).sum(axis=0) / np.where(power > 0, power, np.nan)
        # so written that a joint without power, whose factor is none, is no multiple
        if (rms(values - factors * source) <= EXACT * values.std(axis=0)).all():
            said = f"it equals {other.group.pattern}"
            if not np.allclose(factors, 1.0, atol=EXACT):
                said = f"it is {other.group.pattern} times {figures(factors)}"
            yield said


def usable(values: np.ndarray) -> bool:
    """Whether all values are numbers of a size that robots have in any unit."""
    return bool(np.isfinite(values).all() and np.abs(values).max() < BEYOND)


# All logs of one arm.


TORQUES = ("tau", "tau_sensor")
"""Channels that hold a torque."""
TIME = "time"
"""Label of the table that holds nothing but their time."""
MAIN = "state"
"""Label of the table that holds the positions, if several lie side by side."""
WITHOUT_NAMES = (
    "its columns have no names: their numbers, from 1, stand for them, and what they hold is told by their values; "
    "look at each line"
)
"""Note of a log without a header."""
SILENT_NAMES = "no name says positions: what columns hold is told by their values; look at each line"
"""Note of a log whose names of columns tell too little."""

Entry = dict[str, InspectedTable]
"""Tables that a recording is made of, by label; the one with the positions first."""


@dataclass(frozen=True)
class Inspection:
    """What is in one or several logs of one arm.

    Attributes:
        logs: as they were opened.
        tables: all tables that hold numbers of joints.
        entries: one for each recording, with the same labels.
        misread: what the torque that was chosen shows of the set-up.
        notes: what was left out, and why.
        arm: the nominal arm, if a robot is known.
    """

    logs: tuple[Log, ...]
    tables: tuple[InspectedTable, ...]
    entries: tuple[Entry, ...]
    misread: tuple[Remark, ...] = ()
    notes: tuple[Remark, ...] = ()
    arm: NominalArm | None = None

    @property
    def sources(self) -> Entry:
        """Tables of the first recording."""
        return self.entries[0]

    @property
    def main(self) -> InspectedTable:
        """The table of the first recording that holds the positions."""
        return next(iter(self.sources.values()))

    @cached_property
    def chosen(self) -> dict[str, tuple[str, ChannelGuess]]:
        """Columns taken for each channel, by its name, and the label of the table that holds them."""
        found: dict[str, tuple[str, ChannelGuess]] = {}
        # the table with the positions comes first, so that its columns go before others
        for label, table in self.sources.items():
            for channel in CHANNELS:
                guess = table.best(channel)
                if guess is not None:
                    found.setdefault(channel, (label, guess))
        return found

    @property
    def n_joints(self) -> int:
        """Joints of the arm, if it is known; else columns of the positions."""
        width = self.chosen["q"][1].group.width
        return width if self.arm is None else self.arm.n_joints

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints: those of the columns, or numbers."""
        group = self.chosen["q"][1].group
        # columns may carry names of joints, or only numbers
        if group.by_name:
            return group.labels
        return tuple(f"J{j + 1}" for j in range(group.width))


def inspect_logs(logs: Sequence[Log], arm: NominalArm | None = None) -> Inspection:
    """What is in logs of one arm.

    Args:
        logs: recordings of one kind, or files of one recording that lie side by side, or both.
        arm: the nominal arm with all of its joints, if it is known; those that the logs have are kept.

    Raises:
        InputError: no log holds positions of joints.
    """
    # names of files may call everything a reference, and those of columns tell nothing
    for by_file, by_values in ((True, False), (False, False), (False, True)):
        every = [
            inspect_table(log, part, arm, named_by_file=by_file, by_values=by_values)
            for log in logs
            for part in log.tables
        ]
        # names of files and columns, of columns alone, values: the first that tell
        if any(table.best("q") is not None for table in every):
            break
    tables = [table for table in every if table.channels]
    # tables of one shape together: the same kind of file or topic, once for each recording
    kinds: dict[tuple[object, ...], list[InspectedTable]] = {}
    for table in tables:
        kinds.setdefault(table.shape, []).append(table)
    with_positions = [kind for kind in kinds.values() if kind[0].best("q") is not None]
    if not with_positions:
        known = {guess.channel for table in tables for guess in table.channels}
        found = ", ".join(sorted(known)) or "no channel"
        with_robot = (
            "give --robot, whose joints' names columns may carry and whose limits and gravity tell columns without "
            "names; or "
        ) * (arm is None)
        raise InputError(
            f"no column identifies joint positions, by its name or its values; found {found}",
            with_robot + "name the columns in a case, import: {q: ...}",
            file=logs[0].path,
        )
    # of several with positions the one that tells most
    main = max(
        with_positions, key=lambda kind: len({g.channel for g in kind[0].channels})
    )
    for table in main:
        if len(table.part) < 2:
            raise InputError(
                "has a single row of positions, expected a motion",
                "give a longer recording",
                file=table.log.path,
            )
    others = [kind for kind in kinds.values() if kind is not main]
    times = _times([table for table in every if not table.channels], main)
    if times:
        main = [replace(x, time=y.time) for x, y in zip(main, times, strict=True)]
        tables += times
    sources, notes = _side_by_side(main, others)
    if times:
        sources[TIME] = times
    # one entry for each recording, with a table of each kind
    kinds_of_all = zip(*sources.values(), strict=True)
    entries = [dict(zip(sources, each, strict=True)) for each in kinds_of_all]
    # what each torque column can be by the log alone
    for label, table in entries[0].items():
        channels = [
            replace(guess, facts=tuple(torque_facts(table, guess)))
            if guess.channel in TORQUES
            else guess
            for guess in table.channels
        ]
        entries[0][label] = replace(table, channels=tuple(channels))
    notes = [*_notes(logs, tables), *notes]
    result = Inspection(tuple(logs), tuple(tables), tuple(entries))
    if arm is not None:
        # an arm may have more joints than the log: positions say which
        group = result.chosen["q"][1].group
        arm = _arm_of_columns(arm, group)
        notes += _other_columns(main[0], group, arm)
    return replace(result, notes=tuple(notes), arm=arm)


def _times(
    tables: Sequence[InspectedTable], main: Sequence[InspectedTable]
) -> list[InspectedTable]:
    """Tables of nothing but a time, one for each of those with the positions, if these have none and as many rows."""
    if main[0].time.column is not None:
        return []
    times = [table for table in tables if table.time.column and table.time.unit]
    rows = [len(table.part) for table in main]
    # a single file of stamps beside several recordings is nobody's
    return times if [len(table.part) for table in times] == rows else []


def _side_by_side(
    main: list[InspectedTable], others: Sequence[list[InspectedTable]]
) -> tuple[dict[str, list[InspectedTable]], list[Remark]]:
    """Kinds of tables that hold a channel which none before them does, by label, and notes on what was left out."""
    sources, notes = {MAIN: main}, []
    taken = {guess.channel for guess in main[0].channels}
    for kind in others:
        own = {guess.channel for guess in kind[0].channels}
        news = [name for name in CHANNELS if name in own - taken]
        # as many as there are recordings, or it is not known which belongs to which
        if news and len(kind) != len(main):
            said = (
                f"holds {', '.join(news)}, but there are {len(kind)} of its kind beside {len(main)} with positions: "
                "left out"
            )
            notes.append(note(kind[0].label, said))
        elif news:
            sources[news[0]] = kind
            taken |= own
    return sources, notes


def note(where: str, said: str) -> Remark:
    """What was noticed or left out, of which nothing need be done."""
    return Remark("ok", "log", where, said)


def _notes(logs: Sequence[Log], tables: Sequence[InspectedTable]) -> Iterator[Remark]:
    """What the readers noticed, and logs that hold nothing of joints."""
    yield from (note(log.path.name, said) for log in logs for said in log.notes)
    for table in tables:
        if table.by_values:
            why = WITHOUT_NAMES if table.part.unnamed else SILENT_NAMES
            yield note(table.label, why)
        yield from (note(table.label, said) for said in table.part.notes)
    used = {table.log.path for table in tables}
    unused = (log.path.name for log in logs if log.path not in used)
    yield from (note(name, "holds no numbers of joints") for name in unused)


def _arm_of_columns(arm: NominalArm, group: ColumnGroup) -> NominalArm:
    """The arm with those of its joints that a log has: by name, or the first if it has fewer and names none."""
    named = [joint for joint in arm.joints if joint in group.labels]
    # by name, else the first: the joints of a gripper come last
    kept = named or list(arm.joints[: group.width])
    if len(kept) == arm.n_joints:
        return arm
    return load_nominal_arm(arm.urdf, joints=kept, gravity=tuple(arm.gravity))


def _other_columns(
    table: InspectedTable, group: ColumnGroup, arm: NominalArm
) -> list[Remark]:
    """A note if a log has more positions than the robot has joints, and their order alone says which are taken."""
    n, which = arm.n_joints, f"taken: {span_of(group.names)}"
    left = table.of_another_arm(group.names, n) if group.width == n else ""
    if group.width > n and not set(arm.joints) <= set(group.labels):
        left = f"{group.pattern} has {group.width} columns, the robot {n} joints"
        others = ", ".join(group.labels[n:])
        which = f"taken: the first, {span_of(group.labels[:n])}; {others} left out"
    if not left:
        return []
    said = f"{left}; {which}; for another arm or order list its columns in the case"
    return [note(table.label, said)]


def told_load(table: InspectedTable, arm: NominalArm) -> tuple[KnownLoad, str] | None:
    """The load that a robot was told to carry, by the columns of a log of a known layout, as a point.

    It is in the frame of the joint that moves the last link, and comes with which columns say so and what is uncertain.
    ``None`` if the log holds none, or one that changes, or of no mass.
    """
    layout, columns = layout_of(table.part), table.part.columns
    for place in () if layout is None else layout.loads:
        names = [place["mass"], *(name_of(place["com"], j, "") for j in range(3))]
        if not all(name in columns for name in names):
            continue
        values = np.column_stack([columns[name] for name in names]).astype(float)
        mass, centre = float(values[0, 0]), values[0, 1:]
        # a load of no mass, or one that changes within the recording, is no known load
        if not mass > 0 or np.ptp(values, axis=0).any():
            continue
        where = "the flange's frame, which the robot file does not have: correct com"
        for frame in read_frames(RigidBody(arm)).values():
            meant = frame.name.endswith(tuple(place["frames"]))
            if meant and frame.joint == arm.joints[-1]:
                # from the link that the log means into the frame of the last joint
                centre = frame.place.act(centre)
                where = f"the frame of {frame.name}"
                break
        x, y, z = (round(float(value), 6) for value in centre)
        told = f"told to the robot ({place['mass']}, {place['com']}), its centre in"
        return KnownLoad(mass, (x, y, z)), f"{told} {where}"
    return None


# The case file.


BESIDE = 70
"""Longest reason that stands beside its line; longer ones stand above."""
ABOVE = 110
"""Width of reasons above their line."""


def case_text(found: Inspection, folder: Path, robot: str | None) -> str:
    """Text of ``case.yaml``.

    Args:
        found: what is in the logs.
        folder: in which the case will stand; the logs are named relative to it.
        robot: what ``robot:`` shall say; ``None`` if no robot is known.
    """
    arm = found.arm

    def relative(table: InspectedTable) -> str:
        way = os.path.relpath(table.log.path.resolve(), folder.resolve())
        return Path(way).as_posix()

    recordings: list[str | dict[str, str]] = []
    loads = {}
    for entry in found.entries:
        paths = {label: relative(table) for label, table in entry.items()}
        first, *others = paths.values()
        # side by side within one log: its path alone names all of them
        alone = all(path == first for path in others)
        recordings.append(first if alone else paths)
        load = arm and told_load(next(iter(entry.values())), arm)
        if load:
            loads[first] = load
    # what only a data sheet can say, or of a known robot its file
    sheet = {}
    zeros = [0.0] * found.n_joints
    for quantity, name in SHEET.items():
        unit, values = SHEET_UNITS[name], zeros
        if arm is not None:
            unit = common_unit(unit, arm.sliding)
            # six digits: what a file says, without what floats add to it
            values = [float(f"{x:.6g}") for x in getattr(arm, name)]
        if quantity == "rotor":
            unit += ": rotor inertia times gear ratio squared"
        sheet[name] = values, unit
    return filled(
        Path(__file__).with_name("case.yaml.j2"),
        logs=[log.path.name for log in found.logs],
        name=found.main.log.path.stem if arm is None else arm.name,
        robot=robot,
        joints=None if arm is None else list(arm.joints),
        # the joints of the whole file in its order need not be said
        every=None if arm is None else actuated_joints(read_description(arm.urdf)),
        recordings=recordings,
        loads=loads,
        lines=_import(found),
        beside=BESIDE,
        sheet=sheet,
        referenced="q_ref" in found.chosen,
        rate=_rounded(float(f"{found.main.time.rate:.4g}")),
        zeros=zeros,
    )


def _import(found: Inspection) -> Iterator[tuple[str, str]]:
    """Lines of the import section, each with its reason."""
    main, time = found.main, found.main.time
    entry: dict[str, Any] = {}
    if time.column is not None:
        # columns without names are given by their numbers
        unnamed = found.sources.get(TIME, main).part.unnamed
        entry["column"] = int(time.column) if unnamed else time.column
    entry |= {"unit": time.unit} if time.unit else {"rate": _rounded(time.rate)}
    if TIME in found.sources:
        entry["file"] = TIME
    yield f"time: {flow(entry)}", time.why
    if main.part.kind == LEROBOT:
        numbers = list(range(len(main.log.tables)))
        # the last episode is the one to hold out, if there are several
        listed = flow({"fit": numbers[:-1] or numbers, "judge": numbers[-1:]})
        yield f"# episodes: {listed}", "all are fitted; hold some out by this line"
    elif len(main.log.tables) > 1:
        yield f"topic: {flow(main.part.name)}", "holds the positions"
    if _renamed(found):
        listed = flow(list(found.chosen["q"][1].group.labels))
        yield f"joints: {listed}", "their names in the log, in the order of the robot's"
    sources = found.sources.values()
    if len({table.log.path for table in sources}) > 1:
        # the same number of rows in all files: row by row, else by time
        if len({len(table.part) for table in sources}) == 1:
            yield "join: row", "the files have as many rows"
        else:
            why = "the files differ in length: the last value before counts"
            yield "join: hold", why
    for channel in CHANNELS:
        if channel in found.chosen:
            yield from _channel(found, channel, *found.chosen[channel])
        # a case without torque has to say so
        elif channel == "tau":
            yield "tau: null", "no column name identifies a torque"
    used = [id(guess) for _, guess in found.chosen.values()]
    for label, table in found.sources.items():
        for guess in table.channels:
            # what else could be the torque, or the position if its vendor says what the column holds
            other = guess.channel in TORQUES or (guess.channel == "q" and guess.role)
            if other and id(guess) not in used:
                yield f"# {guess.channel}: {_entry(found, label, guess)}", guess.reason


def _renamed(found: Inspection) -> bool:
    """Whether the log names the joints otherwise than the robot does."""
    group = found.chosen["q"][1].group
    if found.arm is None or not group.by_name:
        return False
    same_number = group.width == found.arm.n_joints
    return same_number and not set(found.arm.joints) <= set(group.labels)


def _channel(
    found: Inspection, channel: str, label: str, guess: ChannelGuess
) -> Iterator[tuple[str, str]]:
    """The line of one channel; a comment if the columns cannot be read as they are."""
    line = f"{channel}: {_entry(found, label, guess)}"
    null, why = f"{channel}: null", _unreadable(channel, guess)
    # a line that cannot be read stays as a comment, and null in its place
    if why:
        yield f"# {line}", f"left out: {why}"
        yield null, ""
    elif guess.unit == "A":
        yield (
            f"# {line}",
            "give the motor constants [N m/A] and gear ratios of the data sheet, and take the # away",
        )
        yield null, guess.reason
    else:
        yield line, guess.reason


def _unreadable(channel: str, guess: ChannelGuess) -> str:
    """Why columns cannot be read as a channel, in words; empty if they can."""
    values = guess.group.values
    if not usable(values):
        # so written that a cell that is no number counts
        cells = (~(np.abs(values) < BEYOND)).sum()
        return f"{cells} cells are empty, no numbers or beyond all sizes"
    if np.ptp(values) == 0 and channel != "q":
        return f"it is {values.flat[0]:g} throughout"
    return ""


def _entry(found: Inspection, label: str, guess: ChannelGuess) -> str:
    """What the import section says of some columns."""
    entry: dict[str, Any] = {"column": _columns_entry(found, guess.group)}
    if guess.unit not in ("", "rad", "rad/s", "N m", "degC"):
        entry["unit"] = guess.unit
    if guess.group.sign_bit is not None:
        entry["sign_bit"] = guess.group.sign_bit
    if guess.unit == "A":
        # zeros to be filled in from the data sheet
        zeros = [0.0] * found.n_joints
        entry |= {"motor_constant": zeros, "gear_ratio": list(zeros)}
    table = found.sources[label]
    # another file is named by its label, another topic of the same log by its name
    if len({other.log.path for other in found.sources.values()}) > 1:
        entry["file"] = label
    elif table is not found.main:
        entry["topic"] = table.part.name
    return flow(entry["column"] if list(entry) == ["column"] else entry)


def _columns_entry(
    found: Inspection, group: ColumnGroup
) -> str | list[str] | list[int]:
    """The pattern, or a list of names if it does not give those of the arm's joints; numbers for lack of names."""
    names = list(group.names[: found.n_joints])
    if group.numbered:
        return [int(name) for name in names]
    if group.seen:
        return names
    if found.arm is None or len(group.names) != group.width:
        return group.pattern
    # the pattern only if it gives these very columns, and no more
    complete = group.width == found.arm.n_joints
    if group.by_name:
        renamed = group.labels == found.chosen["q"][1].group.labels and _renamed(found)
        complete = renamed or set(found.arm.joints) <= set(group.labels)
    return group.pattern if complete else names


def _rounded(rate: float) -> float | int:
    # one whole number of hertz reads as that
    return int(rate) if rate == int(rate) else rate


def filled(template: Path, **content: Any) -> str:
    """A template of a YAML file, filled; ``flow`` writes a value on one line, ``wrap`` a reason on several."""
    environment = Environment(trim_blocks=True, keep_trailing_newline=True)
    environment.filters |= {"flow": flow, "wrap": partial(wrap, width=ABOVE)}
    return environment.from_string(template.read_text("utf-8")).render(**content)


def flow(value: Any) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    # YAML ends a single value with a line of dots
    return text.removesuffix("\n").removesuffix("\n...")


# The drafted case, read: what looks wrong in it, and what each of its torque columns shows of the set-up.


def check_draft(found: Inspection) -> Iterator[Remark]:
    """What looks wrong in the logs, by the drafted case: what it leaves out, and why it cannot be read or what is odd.

    Without an arm the time stamps are looked at, too, which otherwise are a part of what the torque shows.
    """
    for table in (table for entry in found.entries for table in entry.values()):
        if not table.time.certain:
            said = f"nothing in it tells the rate; {table.time.rate:g} Hz is assumed"
            yield Remark("warn", "log", table.label, said, "correct rate: in the case")
    for channel, (label, guess) in found.chosen.items():
        why = _unreadable(channel, guess)
        if why:
            said = f"{guess.group.pattern} left out: {why}"
            yield Remark("warn", "log", found.sources[label].label, said)
    try:
        case = _drafted(found)
    except InputError as error:
        # the draft lies in a folder that is gone: names of files alone
        file = "" if error.file is None else error.file.name
        place = ", ".join(filter(None, (file, error.where)))
        said = ": ".join(filter(None, (place, error.problem)))
        yield Remark("error", "case", "the drafted case", said, error.remedy)
        return
    yield from check_rest(resting(case.recordings, case.arm.per_radian))
    for remark in remarks_on(case.recordings):
        if remark.level != "ok":
            yield remark
    for recording in case.recordings:
        points = set_points(recording)
        if points is not None and points.variant == "held":
            yield Remark(
                "warn",
                "controller",
                recording.name,
                f"q_ref stands still and jumps between: set points come at about 1/{points.every} of the rate of the "
                "log",
                "the controller may interpolate them; what it follows is not in the log",
            )
    if found.arm is None:
        for fault in find_stamps(case.recordings, by_velocity=False):
            yield fault_remark(fault, found.n_joints)
        yield note("the drafted case", "no robot is known: the torque cannot be judged")


def judge_torques(found: Inspection) -> Inspection:
    """What is in logs, with what each torque column shows if the drafted case reads it as the torque.

    That is whether a control law computed it and, of a known arm, what is wrong with the set-up. Of several torques
    without names, the one that fits the arm best is chosen.
    """
    # each column that may be a torque is tried as one, in a draft of its own
    cases = {
        (label, guess.group.pattern): case
        for label, table in found.sources.items()
        for guess in table.channels
        if (case := _with_torque(found, label, guess)) is not None
    }
    known = {} if found.arm is None else cases
    looked = {
        column: set_up
        for column, case in known.items()
        if (set_up := _set_up(case)) is not None
    }
    label = found.chosen.get("tau", ("",))[0]

    def told(guess: ChannelGuess, at: str) -> ChannelGuess:
        column = (at, guess.group.pattern)
        if column not in cases:
            return guess
        first = cases[column].recordings[0]
        said = [*guess.facts, *step_notes(first), *_computed(first)]
        if column in looked:
            # time is the same whichever column is the torque: said once
            remarks = looked[column].remarks()
            said += (remark.text for remark in remarks if remark.topic != "time")
        return replace(guess, facts=tuple(said))

    def rank(guess: ChannelGuess) -> tuple[float, ...]:
        """Torques of a table without names of columns in the order in which they fit the arm."""
        set_up = looked.get((label, guess.group.pattern))
        if guess.channel != "tau" or set_up is None or set_up.off is None:
            return (1.0,)
        # of a torque and the current that it was made from, the one in N m
        return (set_up.off > NO_TORQUE, len(set_up.faults), set_up.off)

    entries = []
    for entry in found.entries:
        tables = {}
        for at, table in entry.items():
            channels = [told(guess, at) for guess in table.channels]
            # only without names: what a name says goes before how well it fits
            if at == label and table.by_values:
                channels.sort(key=rank)
            tables[at] = replace(table, channels=tuple(channels))
        entries.append(tables)
    found = replace(found, entries=tuple(entries))
    if "tau" not in found.chosen:
        return found
    chosen = looked.get((label, found.chosen["tau"][1].group.pattern))
    remarks = () if chosen is None else chosen.remarks()
    misread = tuple(remark for remark in remarks if remark.level != "ok")
    return replace(found, misread=misread)


def _with_torque(found: Inspection, label: str, guess: ChannelGuess) -> Case | None:
    """The drafted case with some columns as the torque; ``None`` if they are none, or it cannot be read."""
    # of an arm that is not known a law alone tells, which has a reference
    if guess.channel not in TORQUES or not (found.arm or "q_ref" in found.chosen):
        return None
    if guess.role in AMPERES:
        # without motor constants the search finds what an ampere makes
        guess = replace(guess, unit="N m")
    first = {}
    for at, table in found.sources.items():
        # any other torque would take this one's place
        channels = [other for other in table.channels if other.channel != "tau"]
        if at == label:
            channels.insert(0, replace(guess, channel="tau"))
        first[at] = replace(table, channels=tuple(channels))
    try:
        return _drafted(replace(found, entries=(first, *found.entries[1:])))
    except InputError:
        # which is said of the draft
        return None


def _set_up(case: Case) -> SetUp | None:
    """What a case shows of its set-up; ``None`` if it cannot be asked."""
    try:
        return look_at_set_up(case)
    except GapscopeError:
        # too short to be differentiated, or without a motion
        return None


def _drafted(found: Inspection) -> Case:
    """The drafted case; an arm that is not known is a chain of free joints.

    Raises:
        InputError: it cannot be read.
    """
    with TemporaryDirectory(prefix="gapscope_") as name:
        folder = Path(name)
        arm = found.arm or _free_chain(found.names, folder / "robot.urdf")
        text = case_text(replace(found, arm=arm), folder, str(arm.urdf.resolve()))
        file = folder / "case.yaml"
        file.write_text(text, encoding="utf-8")
        # in any unit: a wrong one is what the set-up is asked for
        return load_case(file, any_unit=True)


def _free_chain(joints: Sequence[str], file: Path) -> NominalArm:
    """An arm of joints without limits and bodies without mass, written as a URDF."""
    root = ElementTree.Element("robot", name="unknown")
    ElementTree.SubElement(root, "link", name="0")
    for number, joint in enumerate(joints):
        ElementTree.SubElement(root, "link", name=f"{number + 1}")
        own = ElementTree.SubElement(root, "joint", name=joint, type="continuous")
        ElementTree.SubElement(own, "parent", link=f"{number}")
        ElementTree.SubElement(own, "child", link=f"{number + 1}")
    ElementTree.ElementTree(root).write(file)
    return load_nominal_arm(file)
