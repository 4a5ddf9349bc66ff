"""What is in logs: which columns are which channel, in which units, of which joints, and what looks wrong."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import wrap
from typing import Any

import numpy as np
import yaml

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.link_shapes import read_frames
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import actuated_joints
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.layouts import (
    LEROBOT,
    STEPS_PER_TURN,
    UNITS,
    layout_of,
    name_of,
)
from gapscope.arm.io.log import Log
from gapscope.arm.io.plausibility import gap_notes, repeated_rows
from gapscope.arm.io.table import Table, without_damage
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import SHEET_UNITS, NominalArm
from gapscope.arm.recording import CHANNELS, STILL, Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.set_up import Remark, SetUp, fault_remark, look_at_set_up
from gapscope.diagnosis.setup_faults.clocks import find_stamps
from gapscope.diagnosis.thresholds import NO_TORQUE
from gapscope.effects.effect import SHEET
from gapscope.inspection.columns import (
    AMPERES,
    LARGEST,
    ChannelGuess,
    ColumnGroup,
    TableColumns,
    TimeGuess,
    channels_of_table,
    columns_by_values,
    guess_time,
    position_and_velocity,
    sorted_columns,
    unnamed_columns,
)

# One table of a log with what its columns are taken for.


@dataclass(frozen=True)
class InspectedTable:
    """A table, its columns and what they are taken for.

    Attributes:
        log: that holds it.
        part: the table in the log.
        columns: sorted.
        time: where the time stands.
        channels: every group of columns that may be a channel, the best first for each.
    """

    log: Log
    part: Table
    columns: TableColumns
    time: TimeGuess
    channels: tuple[ChannelGuess, ...]

    @property
    def by_values(self) -> bool:
        """Whether values tell what columns hold, their names being silent or missing."""
        held = any(group.holds for group in self.columns.groups)
        return held or self.part.unnamed

    @property
    def label(self) -> str:
        """File and topic, for messages."""
        return " ".join(filter(None, (self.log.path.name, self.part.name)))

    @property
    def shape(self) -> tuple[object, ...]:
        """What tables of several logs of one kind share: topic, and the columns taken for each channel."""
        first = {guess.channel: guess.group for guess in reversed(self.channels)}
        taken = ((name, group.pattern, group.labels) for name, group in first.items())
        return (self.part.name, *sorted(taken))

    def best(self, channel: str) -> ChannelGuess | None:
        """The first columns taken for a channel."""
        return next((g for g in self.channels if g.channel == channel), None)

    def of_another_arm(self, taken: Collection[str], n_joints: int) -> str:
        """Positions beside the columns taken, if there are as many as the arm has joints, in words; else empty."""
        groups = [guess.group for guess in self.channels if guess.channel == "q"]
        every = [name for group in groups for name in group.names]
        beside = [name for name in every if name not in taken]
        if len(beside) < n_joints or len(beside) == len(every):
            return ""
        return f"{beside[0]} to {beside[-1]} are positions, too, as of another arm"


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
    part = without_damage(part)
    context = f"{log.path.stem} {part.name}" if named_by_file else ""
    if part.unnamed:
        columns = unnamed_columns(part, arm, context)
    elif by_values:
        columns = columns_by_values(part, arm, context)
    else:
        columns = sorted_columns(part, () if arm is None else arm.joints)
    position, velocity = position_and_velocity(columns, context)
    rows = np.asarray(part.row_numbers)
    time = guess_time(columns.singles, rows, position, velocity)
    layout = layout_of(part)
    channels = channels_of_table(columns, layout, time, context)
    return InspectedTable(log, part, columns, time, tuple(channels))


# What the torque columns are by the log alone.


# What a torque column can be, by the log alone: silent, unsigned, computed, or another column times a factor.


EXACT = 1e-3
"""Share of a column's deviation that rounding leaves if it is computed from others [1]; a measurement leaves more."""
SAMPLES = 20_000
"""Rows that are looked at, evenly taken."""


def torque_facts(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> list[str]:
    """Sentences on one torque column, each with its figures; empty if nothing strikes.

    Args:
        torque: the columns in question.
        others: all channels of the same table.
    """
    values = _thinned(torque.group.values)
    if not _usable(values):
        return ["it holds cells that are no numbers, or beyond any torque"]
    others = [other for other in others if _usable(other.group.values)]
    silent = np.ptp(values, axis=0) == 0
    if silent.all():
        constant = float(values[0, 0])
        return [f"it is {constant:g} throughout: nothing was measured"]
    facts = []
    if silent.any():
        facts.append(f"it never changes on joint {_numbers(silent)}")
    if (values >= 0).all():
        facts.append("it is never negative: a magnitude, whose sign is lost")
    facts += _quantised(values[:, ~silent])
    facts += _multiples(torque, others)
    facts += _controllers(torque, others)
    return facts


def _quantised(values: np.ndarray) -> Iterator[str]:
    """A column of few different values."""
    counts = [len(np.unique(column)) for column in values.T]
    most = max(counts)
    if most <= min(200, len(values) // 20):
        steps = [
            np.diff(np.unique(column)).min()
            for column in values.T
            if len(np.unique(column)) > 1
        ]
        yield f"it has {most} different values at most, in steps of {min(steps):.3g}"


def _multiples(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """Columns that it is a multiple of, joint by joint."""
    values = _thinned(torque.group.values)
    for other in others:
        if other is torque or other.group.width != torque.group.width:
            continue
        source = _thinned(other.group.values)
        factors = _factors(values, source)
        if factors is None:
            continue
        if np.allclose(factors, 1.0, atol=1e-3):
            yield f"it equals {other.group.pattern}"
        else:
            listed = ", ".join(f"{factor:.4g}" for factor in factors)
            yield f"it is {other.group.pattern} times {listed}"


def _factors(values: np.ndarray, source: np.ndarray) -> np.ndarray | None:
    """Factor of each joint if all columns are multiples of the others', (k,), or ``None``."""
    power = (source**2).sum(axis=0)
    if (power == 0).any():
        return None
    factors = (values * source).sum(axis=0) / power
    left = np.sqrt(((values - factors * source) ** 2).mean(axis=0))
    exact = left <= EXACT * values.std(axis=0)
    return np.asarray(factors) if exact.all() else None


def _controllers(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """A column that is computed from reference and position by gains."""
    values = _thinned(torque.group.values)
    series = {
        other.channel: _thinned(other.group.values)
        for other in reversed(others)
        if _thinned(other.group.values).shape == values.shape
    }
    if "q" not in series or "q_ref" not in series:
        return
    error = series["q_ref"] - series["q"]
    rate = series.get("dq_ref", 0.0) - series.get("dq", np.zeros_like(error))
    gains, left = [], []
    for e, de, tau in zip(error.T, rate.T, values.T, strict=True):
        design = np.column_stack([e, de])
        gain = np.linalg.lstsq(design, tau, rcond=None)[0]
        left.append(np.std(tau - design @ gain) / max(tau.std(), 1e-12))
        gains.append(gain)
    if np.median(left) <= 10 * EXACT:
        kp, kd = (", ".join(f"{x:.4g}" for x in own) for own in np.transpose(gains))
        yield (
            f"it is computed, not measured: kp (q_ref - q) + kd (dq_ref - dq) with kp {kp} and kd {kd}. "
            "As a command that is what it should be; whether the arm obeyed these gains, the log does not say"
        )


def _usable(values: np.ndarray) -> bool:
    """Whether all values are numbers of a size that robots have in any unit."""
    return bool(np.isfinite(values).all() and np.abs(values).max() < LARGEST)


def _thinned(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // SAMPLES)]


def _numbers(mask: np.ndarray) -> str:
    return ", ".join(str(j + 1) for j in np.flatnonzero(mask))


# Which columns are the joints of the arm.


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


# What looks wrong in a log, before any physics.


CLIPPED = 0.02
"""Share of rows at exactly the largest or least value from which a column counts as clipped [1]."""
SPIKE = 20.0
"""Step of one row and back over that of all but one in a hundred from which it counts as a spike [1]."""
TURN = {"rad": 2 * np.pi, "deg": 360.0, "rev": 1.0, "step": STEPS_PER_TURN}
"""A turn in each unit of positions."""
HELD = 0.5
"""Share of rows in which a moving reference stands still from which it counts as held [1]."""


def _odd(where: str, what: str, remedy: str) -> Remark:
    """What looks wrong: file, channel and joint; what was seen, with figures; what to do."""
    return Remark("warn", "log", where, what, remedy)


def oddities_of(
    where: str, time: TimeGuess, channels: Sequence[ChannelGuess]
) -> list[Remark]:
    """What looks wrong in one table.

    Args:
        where: name of the table, for messages.
        time: its time.
        channels: the columns taken for channels, one of each.
    """
    found = [*_time(where, time)]
    by_name = {guess.channel: guess for guess in channels}
    for guess in channels:
        found += _column(where, guess, time)
    found += _pairs(where, by_name)
    if "q" in by_name:
        found += _still(where, by_name["q"])
    return found


def _time(where: str, time: TimeGuess) -> Iterator[Remark]:
    if not time.certain:
        yield _odd(
            where,
            f"nothing in it tells the rate; {time.rate:g} Hz is assumed",
            "correct rate: in the case",
        )
    step = np.diff(time.seconds)
    if not len(step):
        return
    if (step < 0).any():
        row = int(np.flatnonzero(step < 0)[0]) + 1
        yield _odd(
            where,
            f"time jumps back at row {row}",
            "split the log there, or sort its rows",
        )
    # in the words of the reader, which says the same of the drafted case
    for note in repeated_rows(time.seconds, {})[1]:
        yield _odd(where, note, "nothing: they are dropped on reading")
    for note in gap_notes(time.seconds):
        yield _odd(
            where,
            note,
            "the recording is cut there; if nobody stopped it, look why samples were lost",
        )


def _column(where: str, guess: ChannelGuess, time: TimeGuess) -> Iterator[Remark]:
    """Cells that are missing, clipped values and spikes."""
    values = guess.group.values
    missing = int((~np.isfinite(values)).sum())
    if missing:
        yield _odd(
            where,
            f"{guess.group.pattern}: {missing} cells are empty or no numbers",
            "leave the channel out (null); a missing value is never guessed",
        )
        return
    if guess.channel in ("tau", "tau_sensor"):
        for j, column in enumerate(guess.group.values.T):
            if np.ptp(column) == 0:
                continue
            for limit in (column.min(), column.max()):
                share = float((column == limit).mean())
                if limit != 0 and share > CLIPPED and len(np.unique(column)) > 50:
                    yield _odd(
                        f"{where}, joint {j + 1}",
                        f"{guess.group.pattern} stands at {limit:.4g} in {share:.0%} of the rows: a limit was reached",
                        "state torque_limit in the case's nominal section",
                    )
    if guess.channel in ("q", "tau", "tau_sensor"):
        yield from _spikes(where, guess, time)


def _spikes(where: str, guess: ChannelGuess, time: TimeGuess) -> Iterator[Remark]:
    """Values that leave their neighbours for one row."""
    values = guess.group.values
    if len(values) < 100:
        return
    if guess.channel == "q":
        # a position that restarts after a turn is taken back on reading
        values = np.unwrap(values, period=TURN.get(guess.unit, TURN["rad"]), axis=0)
    bend = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    # over rows that were lost a motion goes on
    step = np.diff(time.seconds)
    lost = step > 1.5 * np.median(step)
    bend[lost[1:] | lost[:-1]] = 0.0
    usual = np.quantile(bend, 0.99, axis=0)
    for j in range(values.shape[1]):
        far = bend[:, j] > SPIKE * max(usual[j], 1e-12)
        if usual[j] > 0 and far.any():
            row = int(np.argmax(bend[:, j])) + 2
            yield _odd(
                f"{where}, joint {j + 1}",
                f"{guess.group.pattern} leaves its neighbours in {far.sum()} rows, the worst is row {row}",
                "drop those rows",
            )


def _pairs(where: str, by_name: dict[str, ChannelGuess]) -> Iterator[Remark]:
    """Channels that are copies of others, or references that stand."""
    for measured, asked in (("q", "q_ref"), ("dq", "dq_ref")):
        if measured not in by_name or asked not in by_name:
            continue
        one, other = by_name[measured].group, by_name[asked].group
        moves = np.ptp(one.values, axis=0).any()
        if moves and np.array_equal(one.values, other.values):
            yield _odd(
                where,
                f"{one.pattern} and {other.pattern} are the same numbers: one of them is a copy",
                "a copied reference says nothing of the arm; leave it out (null)",
            )
    for name in ("dq", "dq_ref"):
        position = by_name.get(name[1:])
        velocity = by_name.get(name)
        if position is None or velocity is None:
            continue
        moves = np.ptp(position.group.values, axis=0).any()
        if moves and np.ptp(velocity.group.values) == 0:
            yield _odd(
                where,
                f"{velocity.group.pattern} never changes while {position.group.pattern} moves",
                "it is no velocity; leave it out (null)",
            )
    reference = by_name.get("q_ref")
    if reference is not None:
        step = np.abs(np.diff(reference.group.values, axis=0)).max(axis=1)
        held = float((step == 0).mean())
        # at rest the reference may stand
        if (step > 0).mean() > 0.05 and HELD < held < 0.98 and _evenly_held(step):
            yield _odd(
                where,
                f"{reference.group.pattern} stands still in {held:.0%} of the rows and jumps between: set points "
                f"come at about 1/{round(1 / (1 - held))} of the rate of the log",
                "the controller may interpolate them; what it follows is not in the log",
            )


def _evenly_held(step: np.ndarray) -> bool:
    """Whether jumps come at even distances, as set points at a lower rate do."""
    apart = np.diff(np.flatnonzero(step > 0))
    return bool(
        len(apart) > 10
        and np.median(apart) > 1
        and (apart == np.median(apart)).mean() > 0.5
    )


def _still(where: str, guess: ChannelGuess) -> Iterator[Remark]:
    travel = np.ptp(guess.group.values, axis=0) * UNITS.get(guess.unit, 1.0)
    still = travel < STILL
    if still.all():
        yield _odd(
            where,
            f"the arm stands still: no joint moves by {STILL:g} rad",
            "record a motion of all joints",
        )
    elif still.any():
        numbers = ", ".join(str(j + 1) for j in np.flatnonzero(still))
        yield _odd(
            where,
            f"joint {numbers} does not move: its friction, armature and zero cannot be told",
            "move every joint, slowly and fast, in both directions",
        )


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


@dataclass(frozen=True)
class Inspection:
    """What is in one or several logs of one arm.

    Attributes:
        logs: as they were opened.
        tables: all tables that hold numbers of joints.
        sources: tables that a recording is made of, by label; the one with the positions first.
        entries: one for each recording: its tables by the labels of ``sources``.
        chosen: columns taken for each channel, by its name, and the label of the table that holds them.
        torques: what each torque column can be, in sentences, by the label of its table and the pattern of its columns.
        misread: what the torque that was chosen shows of the set-up.
        oddities: what looks wrong.
        notes: what was left out, and why.
        arm: the nominal arm, if a robot is known.
    """

    logs: tuple[Log, ...]
    tables: tuple[InspectedTable, ...]
    sources: dict[str, InspectedTable]
    entries: tuple[dict[str, InspectedTable], ...]
    chosen: dict[str, tuple[str, ChannelGuess]]
    torques: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    misread: tuple[Remark, ...] = ()
    oddities: tuple[Remark, ...] = ()
    notes: tuple[Remark, ...] = ()
    arm: NominalArm | None = None

    @property
    def main(self) -> InspectedTable:
        """The table of the first recording that holds the positions."""
        return next(iter(self.sources.values()))

    @property
    def n_joints(self) -> int:
        """Joints of the arm, if it is known; else columns of the positions."""
        width = self.chosen["q"][1].group.width
        return width if self.arm is None else self.arm.n_joints


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
        if any(table.best("q") is not None for table in every):
            break
    tables = [table for table in every if table.channels]
    kinds = _kinds(tables)
    with_positions = [kind for kind in kinds if kind[0].best("q") is not None]
    # of several with positions the one that tells most
    main = max(with_positions, key=_told, default=None)
    if main is None:
        raise _without_positions(logs, tables)
    times = _times([table for table in every if not table.channels], main)
    if times:
        main = [
            replace(table, time=clock.time)
            for table, clock in zip(main, times, strict=True)
        ]
        kinds = [main, *(kind for kind in kinds if kind[0].shape != main[0].shape)]
        tables += times
    sources, chosen, notes = _chosen(kinds, main)
    if times:
        sources[TIME] = times
    entries = tuple(
        {label: kind[number] for label, kind in sources.items()}
        for number in range(len(main))
    )
    first = {label: kind[0] for label, kind in sources.items()}
    if arm is not None:
        group = chosen["q"][1].group
        arm = arm_of_columns(arm, group)
        notes += _other_columns(main[0], group, arm)
    return Inspection(
        logs=tuple(logs),
        tables=tuple(tables),
        sources=first,
        entries=entries,
        chosen=chosen,
        # what each torque column can be by the log alone
        torques={
            (label, guess.group.pattern): torque_facts(guess, table.channels)
            for label, table in first.items()
            for guess in table.channels
            if guess.channel in TORQUES
        },
        oddities=oddities_in(entries, chosen),
        notes=(*_notes(logs, tables), *notes),
        arm=arm,
    )


def _times(
    tables: Sequence[InspectedTable], main: Sequence[InspectedTable]
) -> list[InspectedTable]:
    """Tables of nothing but a time, one for each of those with the positions, if these have none and as many rows."""
    if main[0].time.column is not None:
        return []
    times = [table for table in tables if table.time.column and table.time.unit]
    rows = [len(table.part) for table in main]
    return times if [len(table.part) for table in times] == rows else []


def _kinds(tables: Sequence[InspectedTable]) -> list[list[InspectedTable]]:
    """Tables of one shape together: the same kind of file or topic, once for each recording."""
    kinds: dict[tuple[object, ...], list[InspectedTable]] = {}
    for table in tables:
        kinds.setdefault(table.shape, []).append(table)
    return list(kinds.values())


def _told(kind: list[InspectedTable]) -> int:
    """Number of channels that tables of a kind hold."""
    return len({guess.channel for guess in kind[0].channels})


def _chosen(
    kinds: Sequence[list[InspectedTable]], main: list[InspectedTable]
) -> tuple[
    dict[str, list[InspectedTable]], dict[str, tuple[str, ChannelGuess]], list[Remark]
]:
    """Kinds of tables by label, columns of each channel with their label, and notes on what was left out."""
    sources = {MAIN: main}
    chosen: dict[str, tuple[str, ChannelGuess]] = {}
    notes: list[Remark] = []
    for kind in (main, *(kind for kind in kinds if kind is not main)):
        news = [name for name in CHANNELS if name not in chosen and kind[0].best(name)]
        if not news:
            continue
        if len(kind) != len(main):
            said = (
                f"holds {', '.join(news)}, but there are {len(kind)} of its kind beside {len(main)} with positions: "
                "left out"
            )
            notes.append(note(kind[0].label, said))
            continue
        label = MAIN if kind is main else news[0]
        sources[label] = kind
        for name in news:
            guess = kind[0].best(name)
            assert guess is not None
            chosen[name] = (label, guess)
    return sources, chosen, notes


def oddities_in(
    entries: Sequence[dict[str, InspectedTable]],
    chosen: dict[str, tuple[str, ChannelGuess]],
) -> tuple[Remark, ...]:
    """What looks wrong in the tables of every recording."""
    found: list[Remark] = []
    for entry in entries:
        for label, table in entry.items():
            used = [name for name, (place, _) in chosen.items() if place == label]
            guesses = [guess for name in used if (guess := table.best(name))]
            found += oddities_of(table.label, table.time, guesses)
    return tuple(found)


def note(where: str, said: str) -> Remark:
    """What was noticed or left out, of which nothing need be done."""
    return Remark("ok", "log", where, said)


def _notes(logs: Sequence[Log], tables: Sequence[InspectedTable]) -> Iterator[Remark]:
    """What the readers noticed, and logs that hold nothing of joints."""
    used = {table.log.path for table in tables}
    yield from (note(log.path.name, said) for log in logs for said in log.notes)
    for table in tables:
        if table.by_values:
            why = WITHOUT_NAMES if table.part.unnamed else SILENT_NAMES
            yield note(table.label, why)
        yield from (note(table.label, said) for said in table.part.notes)
    for log in logs:
        if log.path not in used:
            yield note(log.path.name, "holds no numbers of joints")


def _other_columns(
    table: InspectedTable, group: ColumnGroup, arm: NominalArm
) -> list[Remark]:
    """A note if a log has more positions than the robot has joints, and their order alone says which are taken."""
    n, left = arm.n_joints, ""
    if group.width > n and not set(arm.joints) <= set(group.labels):
        left = f"{group.pattern} has {group.width} columns, the robot {n} joints"
    elif group.width == n:
        left = table.of_another_arm(group.names, n)
    if not left:
        return []
    taken, others = group.labels[:n], group.labels[n:]
    which = f"the first, {taken[0]} to {taken[-1]}, are taken, and {', '.join(others)} left out"
    if not others:
        which = f"{group.names[0]} to {group.names[-1]} are taken"
    said = f"{left}: {which}; for another arm or order list its columns in the case"
    return [note(table.label, said)]


def _without_positions(
    logs: Sequence[Log], tables: Sequence[InspectedTable]
) -> InputError:
    found = sorted({guess.channel for table in tables for guess in table.channels})
    return InputError(
        f"no column identifies joint positions, by its name or its values; found {', '.join(found) or 'no channel'}",
        "give --robot, whose joints' names columns may carry and whose limits and gravity tell columns without names; "
        "or name the columns in a case, import: {q: ...}",
        file=logs[0].path,
    )


# The load that a robot was told to carry, by the columns of a log of a known layout.


@dataclass(frozen=True)
class ToldLoad:
    """A load as a robot was told of it.

    Attributes:
        load: as a point, in the frame of the joint that moves the last link.
        why: which columns say so, and what is uncertain.
    """

    load: KnownLoad
    why: str


def told_load(table: InspectedTable, arm: NominalArm) -> ToldLoad | None:
    """The load that a table holds; ``None`` if it holds none, or one that changes, or of no mass."""
    layout = layout_of(table.part)
    for place in () if layout is None else layout.loads:
        names = [place["mass"], *(name_of(place["com"], j, "") for j in range(3))]
        columns = table.part.columns
        if not all(name in columns for name in names):
            continue
        values = np.column_stack([columns[name] for name in names]).astype(float)
        mass, *centre = values[0]
        if mass > 0 and np.ptp(values, axis=0).max() == 0:
            return _placed(place, mass, np.array(centre), arm)
    return None


def _placed(
    place: Mapping[str, Any], mass: float, centre: np.ndarray, arm: NominalArm
) -> ToldLoad:
    """The load in the frame of the last joint."""
    frames = read_frames(RigidBody(arm)).values()
    of_last = [frame for frame in frames if frame.joint == arm.joints[-1]]
    why = f"told to the robot ({place['mass']}, {place['com']})"
    for frame in of_last:
        if frame.name.endswith(tuple(place["frames"])):
            centre = frame.position + frame.rotation @ centre
            why += f", its centre in the frame of {frame.name}"
            break
    else:
        why += ", its centre in the flange's frame, which the robot file does not have: correct com"
    x, y, z = (round(float(value), 6) for value in centre)
    return ToldLoad(KnownLoad(float(mass), (x, y, z)), why)


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
    names = ", ".join(log.path.name for log in found.logs[:4])
    more = f" and {len(found.logs) - 4} more" if len(found.logs) > 4 else ""
    lines = [
        f"# Drafted by gapscope inspect from {names}{more}. Every entry is a guess, with its reason beside it.",
        f"name: {flow(_name(found))}",
        *_robot(found, robot),
        *_recordings(found, folder),
        *_payloads(found, folder),
        "import:",
        *_aligned(_import(found)),
        *_data_sheet(found),
    ]
    return "\n".join(lines) + "\n"


def _name(found: Inspection) -> str:
    if found.arm is not None:
        return found.arm.name
    return found.main.log.path.stem


def _robot(found: Inspection, robot: str | None) -> Iterator[str]:
    """The robot, and its joints if the log has fewer or other ones."""
    if robot is None:
        yield "robot: robot.urdf  # not known: put the URDF or MJCF of the arm here"
        return
    yield f"robot: {flow(robot)}"
    assert found.arm is not None
    listed = flow(list(found.arm.joints))
    if list(found.arm.joints) == actuated_joints(read_description(found.arm.urdf)):
        yield f"# joints: {listed}  # the order of the columns, if it is another"
    else:
        yield f"joints: {listed}  # those of the robot that the log has; all others stay where they are"


def _recordings(found: Inspection, folder: Path) -> Iterator[str]:
    yield "recordings:"
    for entry in found.entries:
        paths = {
            label: _relative(table.log.path, folder) for label, table in entry.items()
        }
        alone = len(set(paths.values())) == 1
        yield f"  - {flow(paths[MAIN]) if alone else flow(paths)}"
    if len(found.entries) > 2:
        yield "# judge: [FILE]  # name one of them here in place of above: it is held out and never fitted"


def _payloads(found: Inspection, folder: Path) -> Iterator[str]:
    """The load of each recording, if its robot was told of one."""
    told = {
        _relative(entry[label].log.path, folder): load
        for entry in found.entries
        for label in list(entry)[:1]
        if found.arm is not None
        and (load := told_load(entry[label], found.arm)) is not None
    }
    if told:
        yield "payloads:"
    for name, load in told.items():
        yield f"  {flow(name)}: {flow(load.load.entry())}  # {load.why}"


def _import(found: Inspection) -> Iterator[tuple[str, str]]:
    """Lines of the import section, each with its reason."""
    yield _time_entry(found)
    main = found.main
    if main.part.kind == LEROBOT:
        numbers = list(range(len(main.log.tables)))
        listed = flow({"fit": numbers[:-1] or numbers, "judge": numbers[-1:]})
        yield f"# episodes: {listed}", "all are fitted; hold some out by this line"
    elif len(main.log.tables) > 1:
        yield f"topic: {flow(main.part.name)}", "holds the positions"
    if _renamed(found):
        listed = flow(list(found.chosen["q"][1].group.labels))
        yield f"joints: {listed}", "their names in the log, in the order of the robot's"
    files = {table.log.path for table in found.sources.values()}
    if len(files) > 1:
        yield _join(found)
    for channel in CHANNELS:
        if channel in found.chosen:
            label, guess = found.chosen[channel]
            yield from _channel(found, channel, label, guess)
        elif channel == "tau":
            yield "tau: null", "no column name identifies a torque"
    used = [guess for _, guess in found.chosen.values()]
    for label, table in found.sources.items():
        for guess in table.channels:
            # what else could be the torque, or the position if its vendor says what the column holds
            other = guess.channel in TORQUES or (guess.channel == "q" and guess.role)
            if other and guess not in used:
                line = f"# {guess.channel}: {_entry(found, label, guess)}"
                yield line, _reason(found, label, guess)


def _renamed(found: Inspection) -> bool:
    """Whether the log names the joints otherwise than the robot does."""
    group = found.chosen["q"][1].group
    if found.arm is None or not group.by_name:
        return False
    same_number = group.width == found.arm.n_joints
    return same_number and not set(found.arm.joints) <= set(group.labels)


def _join(found: Inspection) -> tuple[str, str]:
    """How files side by side meet."""
    rows = {len(table.part) for table in found.sources.values()}
    if len(rows) == 1:
        return "join: row", "the files have as many rows"
    return "join: hold", "the files differ in length: the last value before counts"


def _time_entry(found: Inspection) -> tuple[str, str]:
    time = found.main.time
    column: str | int | None = time.column
    table = found.sources.get(TIME, found.main).part
    if column is not None and table.unnamed:
        column = int(column)
    if column is None:
        entry: dict[str, Any] = {"rate": _rounded(time.rate)}
    elif not time.unit:
        entry = {"column": column, "rate": _rounded(time.rate)}
    else:
        entry = {"column": column, "unit": time.unit}
    if TIME in found.sources:
        entry["file"] = TIME
    return f"time: {flow(entry)}", time.why


def _channel(
    found: Inspection, channel: str, label: str, guess: ChannelGuess
) -> Iterator[tuple[str, str]]:
    """The line of one channel; a comment if the columns cannot be read as they are."""
    line = f"{channel}: {_entry(found, label, guess)}"
    values = guess.group.values
    if not np.isfinite(values).all() or np.abs(values).max() > LARGEST:
        yield f"# {line}", "left out: it holds cells that are no numbers"
        yield f"{channel}: null", ""
    elif np.ptp(values) == 0 and channel != "q":
        yield f"# {line}", f"left out: it is {values.flat[0]:g} throughout"
        yield f"{channel}: null", ""
    elif guess.unit == "A":
        yield (
            f"# {line}",
            "give the motor constants [N m/A] and gear ratios of the data sheet, and take the # away",
        )
        yield f"{channel}: null", _reason(found, label, guess)
    else:
        yield line, _reason(found, label, guess)


def _entry(found: Inspection, label: str, guess: ChannelGuess) -> str:
    """What the import section says of some columns."""
    entry: dict[str, Any] = {"column": _columns_entry(found, guess)}
    if guess.unit not in ("", "rad", "rad/s", "N m", "degC"):
        entry["unit"] = guess.unit
    if guess.group.sign_bit is not None:
        entry["sign_bit"] = guess.group.sign_bit
    if guess.unit == "A":
        n = found.n_joints
        entry |= {"motor_constant": [0.0] * n, "gear_ratio": [0.0] * n}
    table = found.sources[label]
    if len({other.log.path for other in found.sources.values()}) > 1:
        entry["file"] = label
    elif table is not found.main:
        entry["topic"] = table.part.name
    if list(entry) == ["column"]:
        return flow(entry["column"])
    return flow(entry)


def _columns_entry(
    found: Inspection, guess: ChannelGuess
) -> str | list[str] | list[int]:
    """The pattern, or a list of names if it does not give those of the arm's joints; numbers for lack of names."""
    group = guess.group
    if group.numbered:
        return [int(name) for name in group.names[: found.n_joints]]
    if group.seen:
        return list(group.names[: found.n_joints])
    if found.arm is None or len(group.names) != group.width:
        return group.pattern
    joints = found.arm.joints
    if "{joint}" not in group.pattern and group.width == len(joints):
        return group.pattern
    main = found.chosen["q"][1].group
    if group.by_name and (set(joints) <= set(group.labels)):
        return group.pattern
    if _renamed(found) and group.labels == main.labels:
        return group.pattern
    places = columns_of_arm(group, joints)
    return (
        list(group.names)
        if places is None
        else [group.names[place] for place in places]
    )


def _reason(found: Inspection, label: str, guess: ChannelGuess) -> str:
    """Why columns are taken for what they are."""
    if guess.channel not in TORQUES:
        return "; ".join(filter(None, (guess.why, guess.role)))
    facts = found.torques.get((label, guess.group.pattern), [])
    said = guess.why if guess.group.seen else guess.role or guess.why
    return "; ".join(filter(None, (said, *facts)))


def _data_sheet(found: Inspection) -> Iterator[str]:
    """What only a data sheet can say; of a known robot, what its file says."""
    yield "# nominal:  # the data sheet, one value per joint, joint side; take the # away to state it"
    for quantity, name in SHEET.items():
        unit = SHEET_UNITS[name]
        if quantity == "rotor":
            unit += ": rotor inertia times gear ratio squared"
        values = [0.0] * found.n_joints
        if found.arm is not None:
            values = [float(f"{x:.6g}") for x in getattr(found.arm, name)]
        yield f"#   {name}: {flow(values)}  # {unit}"
    yield "#   encoder: motor  # motor, or joint: the side of the gear on which the position is measured"
    yield from _controller(found)


def _controller(found: Inspection) -> Iterator[str]:
    """A controller to fill in, if the log holds what it followed."""
    if "q_ref" not in found.chosen:
        return
    zeros = flow([0.0] * found.n_joints)
    rate = _rounded(float(f"{found.main.time.rate:.4g}"))
    yield f"# controller: {{kind: pd, rate: {rate}, kp: {zeros}, kd: {zeros}}}  # for replay: N m/rad, N m s/rad"


def _aligned(lines: Iterator[tuple[str, str]]) -> Iterator[str]:
    """Lines with their reasons: beside them if short, else above."""
    for text, reason in lines:
        if len(reason) > BESIDE:
            for part in wrap(reason, ABOVE):
                yield f"  # {part}"
            yield f"  {text}"
        else:
            yield f"  {text}  # {reason}" if reason else f"  {text}"


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def _rounded(rate: float) -> float | int:
    return int(rate) if rate == int(rate) else rate


def flow(value: Any) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")


# The drafted case, read: whether it can be, and what each of its torque columns shows of the set-up.


def check_draft(found: Inspection) -> list[Remark]:
    """Read the drafted case: why it cannot be read as it is, or what the reader noticed, and dropped."""
    place, problem, remedy = (
        "the drafted case",
        "no robot is known: the torque cannot be judged",
        "",
    )
    if found.arm is not None:
        try:
            recordings = _drafted(found).recordings
            return [note(r.name, said) for r in recordings for said in r.notes]
        except GapscopeError as error:
            problem, remedy = _said(error), error.remedy
    return [Remark("error", "case", place, problem, remedy)]


def judge_torques(found: Inspection) -> Inspection:
    """What is in logs, with what each torque column shows of the set-up if the drafted case reads it as the torque.

    Of several torques without names, the one that fits the arm best is chosen. Without an arm the stamps alone tell.
    """
    if found.arm is None:
        return replace(found, misread=tuple(_of_stamps(found)))
    looked: dict[tuple[str, str], SetUp] = {}
    torques = dict(found.torques)
    for label, table in found.sources.items():
        for guess in table.channels:
            set_up = _set_up(found, label, guess)
            if set_up is not None:
                place = label, guess.group.pattern
                looked[place] = set_up
                remarks = set_up.remarks()
                said = [remark.text for remark in remarks if remark.topic != "time"]
                torques[place] = [*torques[place], *said]
    found = _best_first(replace(found, torques=torques), looked)
    if "tau" not in found.chosen:
        return found
    label, guess = found.chosen["tau"]
    chosen = looked.get((label, guess.group.pattern))
    if chosen is None:
        return found
    misread = tuple(remark for remark in chosen.remarks() if remark.level != "ok")
    return replace(found, misread=misread)


def _of_stamps(found: Inspection) -> Iterator[Remark]:
    """What is wrong with the time stamps of logs, as a diagnosis finds it."""
    label, _ = found.chosen["q"]
    for entry in found.entries:
        table = entry[label]
        guess = table.best("q")
        if guess is None:
            continue
        t, q = table.time.seconds, guess.group.values
        # what stands still, jumps back or is no number is said of the columns
        usable = np.isfinite(q).all(axis=1)
        usable &= np.diff(np.maximum.accumulate(t), prepend=-np.inf) > 0
        for fault in find_stamps([Recording(table.label, t[usable], q[usable])]):
            yield fault_remark(fault, guess.group.width)


def _set_up(found: Inspection, label: str, guess: ChannelGuess) -> SetUp | None:
    """What the drafted case with some columns as the torque shows; ``None`` if it cannot be asked."""
    if found.arm is None or guess.channel not in TORQUES:
        return None
    if guess.role in AMPERES:
        # without motor constants the search finds what an ampere makes
        guess = replace(guess, unit="N m")
    torque = {"tau": (label, replace(guess, channel="tau"))}
    try:
        case = _drafted(replace(found, chosen=found.chosen | torque))
        return look_at_set_up(case)
    except GapscopeError:
        # it cannot be read, which is said of the draft, or is too short to be differentiated
        return None


def _drafted(found: Inspection) -> Case:
    """The drafted case.

    Raises:
        GapscopeError: it cannot be read.
    """
    assert found.arm is not None
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "case.yaml"
        text = case_text(found, Path(folder), str(found.arm.urdf.resolve()))
        file.write_text(text, encoding="utf-8")
        return load_case(file, any_unit=True)


def _said(error: GapscopeError) -> str:
    """An error on the draft, which lies in a folder that is gone: names of files alone."""
    if not isinstance(error, InputError):
        return error.message
    file = error.file.name if error.file is not None else ""
    place = ", ".join(filter(None, (file, error.where)))
    return f"{place}: {error.problem}" if place else error.problem


def _best_first(found: Inspection, looked: dict[tuple[str, str], SetUp]) -> Inspection:
    """The torques of a table without names of columns in the order in which they fit the arm."""

    def rank(guess: ChannelGuess) -> tuple[float, ...]:
        set_up = looked.get((label, guess.group.pattern))
        if guess.channel != "tau" or set_up is None or set_up.off is None:
            return (1.0,)
        # of a torque and the current that it was made from, the one in N m
        return (set_up.off > NO_TORQUE, len(set_up.faults), set_up.off)

    def ordered(table: InspectedTable) -> InspectedTable:
        return replace(table, channels=tuple(sorted(table.channels, key=rank)))

    for label, table in found.sources.items():
        torque = found.chosen.get("tau", ("",))[0]
        if label == torque and table.by_values:
            entries = tuple(
                {**entry, label: ordered(entry[label])} for entry in found.entries
            )
            sources = {**found.sources, label: ordered(table)}
            best = sources[label].best("tau")
            assert best is not None
            chosen = {**found.chosen, "tau": (label, best)}
            return replace(
                found,
                entries=entries,
                sources=sources,
                chosen=chosen,
                oddities=oddities_in(entries, chosen),
            )
    return found
