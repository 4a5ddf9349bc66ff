"""What is in logs: which columns are which channel, in which units, of which joints, and what looks wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from gapscope.arm.errors import InputError
from gapscope.arm.io.log import Log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import CHANNELS
from gapscope.diagnosis.set_up import Remark
from gapscope.inspection.channels import ChannelGuess
from gapscope.inspection.columns import ColumnGroup
from gapscope.inspection.inspected_table import InspectedTable, inspect_table
from gapscope.inspection.oddities import oddities_of
from gapscope.inspection.torque_facts import arm_of_columns, torque_facts

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
    every = _tables(logs, arm)
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
        torques=_torques(first),
        oddities=oddities_in(entries, chosen),
        notes=(*_notes(logs, tables), *notes),
        arm=arm,
    )


def _tables(logs: Sequence[Log], arm: NominalArm | None) -> list[InspectedTable]:
    """All tables, with what their columns are taken for."""
    # names of files may call everything a reference, and those of columns tell nothing
    for by_file, by_values in ((True, False), (False, False), (False, True)):
        found = [
            inspect_table(log, part, arm, named_by_file=by_file, by_values=by_values)
            for log in logs
            for part in log.tables
        ]
        if any(table.best("q") is not None for table in found):
            break
    return found


def _times(
    tables: Sequence[InspectedTable], main: Sequence[InspectedTable]
) -> list[InspectedTable]:
    """Tables of nothing but a time, one for each of those with the positions, if these have none and as many rows."""
    if main[0].time.column is not None:
        return []
    times = [table for table in tables if table.time.column and table.time.unit]
    rows = [len(table.part.table) for table in main]
    return times if [len(table.part.table) for table in times] == rows else []


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


def _torques(
    sources: dict[str, InspectedTable],
) -> dict[tuple[str, str], list[str]]:
    """What each torque column can be by the log alone."""
    return {
        (label, guess.group.pattern): torque_facts(guess, table.channels)
        for label, table in sources.items()
        for guess in table.channels
        if guess.channel in TORQUES
    }


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
            why = WITHOUT_NAMES if table.part.table.unnamed else SILENT_NAMES
            yield note(table.label, why)
        yield from (note(table.label, said) for said in table.part.table.notes)
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
