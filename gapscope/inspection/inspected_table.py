"""One table of a log with what its columns are taken for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.io.layouts import layout_of
from gapscope.arm.io.log import Log, LogTable
from gapscope.arm.io.table import without_damage
from gapscope.arm.nominal import NominalArm
from gapscope.inspection.channels import (
    ChannelGuess,
    channels_of_table,
    position_and_velocity,
)
from gapscope.inspection.columns import TableColumns, sorted_columns
from gapscope.inspection.time_column import TimeGuess, guess_time
from gapscope.inspection.unnamed_columns import columns_by_values, unnamed_columns


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
    part: LogTable
    columns: TableColumns
    time: TimeGuess
    channels: tuple[ChannelGuess, ...]

    @property
    def by_values(self) -> bool:
        """Whether values tell what columns hold, their names being silent or missing."""
        held = any(group.holds for group in self.columns.groups)
        return held or self.part.table.unnamed

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
    part: LogTable,
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
    part = replace(part, table=without_damage(part.table))
    context = f"{log.path.stem} {part.name}" if named_by_file else ""
    if part.table.unnamed:
        columns = unnamed_columns(part.table, arm, context)
    elif by_values:
        columns = columns_by_values(part.table, arm, context)
    else:
        columns = sorted_columns(part.table, () if arm is None else arm.joints)
    position, velocity = position_and_velocity(columns, context)
    rows = np.asarray(part.table.row_numbers)
    time = guess_time(columns.singles, rows, position, velocity)
    layout = layout_of(part.table, part.kind)
    channels = channels_of_table(columns, layout, time, context)
    return InspectedTable(log, part, columns, time, tuple(channels))
