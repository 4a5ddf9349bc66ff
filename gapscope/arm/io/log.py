"""A log as it is: its tables, before anything is known of the arm that made it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_IN_MEMORY, check_file, is_folder
from gapscope.arm.io.formats.array_files import read_hdf5, read_mat
from gapscope.arm.io.formats.lerobot import INFO, is_dataset, read_dataset
from gapscope.arm.io.formats.rosbag import METADATA, bag_files, read_bag
from gapscope.arm.io.formats.table_files import (
    read_csv,
    read_json_lines,
    read_npz,
    read_parquet,
)
from gapscope.arm.io.table import Log, Table
from gapscope.arm.nearest_name import shortened

__all__ = ["READERS", "Log", "open_log"]


CHECK_PATH = "check the path"


TEXTS = (".csv", ".tsv", ".txt", ".dat", ".asc")
"""Endings of tables of text."""

_OF_ONE_TABLE: dict[str, Callable[[Path], Table]] = {
    **dict.fromkeys(TEXTS, read_csv),
    ".jsonl": read_json_lines,
    ".parquet": read_parquet,
    ".npz": read_npz,
}


def _read_table(path: Path) -> Log:
    """Log of a file with one table."""
    check_file(path, CHECK_PATH, LARGEST_IN_MEMORY)
    table, kind = _OF_ONE_TABLE[path.suffix.lower()](path), path.suffix[1:].upper()
    return Log(path, kind, (replace(table, kind=kind),))


READERS: dict[str, Callable[[Path], Log]] = {
    **dict.fromkeys(_OF_ONE_TABLE, _read_table),
    ".db3": read_bag,
    ".mcap": read_bag,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".mat": read_mat,
}
"""Readers of files by their ending."""


def open_log(path: str | Path) -> Log:
    """Read all tables of a log, of any format that recordings may have.

    Raises:
        InputError: there is no such file, its format is not known, or it is damaged.
    """
    path = Path(path)
    if is_folder(path):
        if is_dataset(path):
            return read_dataset(path)
        # whatever it is: what is no regular file is refused by name
        if os.path.lexists(path / METADATA):
            return read_bag(path)
        # a folder of loose files: which of them may be meant
        logs = [x.name for x in bag_files(path) if x.suffix.lower() in READERS]
        raise InputError(
            f"is a folder with neither {METADATA} of a rosbag2 nor {INFO} of a LeRobot dataset",
            f"give one of its files: {shortened(logs)}" if logs else CHECK_PATH,
            file=path,
        )
    check_file(path, CHECK_PATH)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"the ending {path.suffix!r} names no known format",
            f"give a file that ends in {', '.join(READERS)}, a rosbag2 folder, or a LeRobot dataset",
            file=path,
        )
    return reader(path)


def check_no_log(path: Path) -> None:
    """Check that what was given for a case, its file or folder, is no recording.

    Raises:
        InputError: it is a log, or the folder of one.
    """
    # a case may lie in the folder of its bag
    case = os.path.lexists(path / "case.yaml")
    bag = os.path.lexists(path / METADATA) or is_dataset(path)
    if path.suffix.lower() in READERS or (bag and not case):
        raise InputError(
            "is a log, and a case was expected",
            f"gapscope inspect {path} tells what is in it, and with --robot and --out makes a case of it",
            file=path,
        )
