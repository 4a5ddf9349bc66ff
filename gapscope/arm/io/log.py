"""A log as it is: its tables, before anything is known of the arm that made it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.io.table import Table
from gapscope.arm.io.table_files import read_csv, read_npz, read_parquet

TABLE_READERS = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
}
"""Readers of files that hold one table, by their ending."""


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
        tables: all that it holds.
        robot_description: URDF text, if the log holds one.
        notes: what was noticed while reading.
    """

    path: Path
    format: str
    tables: tuple[LogTable, ...]
    robot_description: str | None = None
    notes: tuple[str, ...] = ()


def open_log(path: str | Path) -> Log:
    """Read all tables of a log, of any format that recordings may have.

    Raises:
        InputError: there is no such file, its format is not known, or it is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file or folder", "check the path", file=path)
    reader = TABLE_READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"the ending {path.suffix!r} names no known format",
            f"give a file that ends in {', '.join(TABLE_READERS)}, .mcap or .db3, or a rosbag2 folder",
            file=path,
        )
    table = reader(path)
    kind = path.suffix.lstrip(".").upper()
    return Log(path, kind, (LogTable("", kind, table),))
