"""What a reader of any format gives: the tables of a log, before anything is known of the arm that made it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.io.table import Table


@dataclass(frozen=True)
class LogTable:
    """One table of a log.

    Attributes:
        name: topic, group or episode that holds it; empty if the file is one table.
        kind: type of the messages, or the format of the file.
        table: its columns. Those of ROS messages are named by field and joint, ``position[joint_1]`` or
            ``reference.positions[joint_1]``, beside ``t`` [s], the header's stamp.
    """

    name: str
    kind: str
    table: Table


@dataclass(frozen=True)
class Log:
    """What is in a log.

    Attributes:
        path: file or folder.
        format: in words, ``CSV`` or ``ROS 2 bag (MCAP)``.
        tables: all that it holds. A topic whose messages name different joints, an arm's and a gripper's, gives a
            table for each set of joints.
        robot_description: URDF text, if the log holds one.
        notes: what was noticed while reading.
        unread: what it holds beside the tables, in words: topics of other types, arrays of another shape.
    """

    path: Path
    format: str
    tables: tuple[LogTable, ...]
    robot_description: str | None = None
    notes: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the tables, each once."""
        return list(dict.fromkeys(table.name for table in self.tables))
