"""Files written by one process at a time, and folders locked while they are used."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.case_file import CasePaths
from gapscope.arm.io.log import open_log

# One run at a time in a folder of results, by a lock that the system lets go of when its process ends.


LOCK = ".lock"
"""File of a folder that a run writes to; says which run, and is gone after it, unless the run was killed."""


@contextmanager
def locked(folder: Path | None) -> Iterator[None]:
    """Hold a folder for this process, and make it if need be; ``None``: nothing is written, nothing is held.

    A file that a killed run left behind holds nothing. A folder that was made for the run and is empty after it is
    removed.

    Raises:
        GapscopeError: another process holds the folder, or it cannot be written to.
    """
    with nullcontext() if folder is None else _held(folder):
        yield


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    made = not folder.exists()
    file = folder / LOCK
    lock = FileLock(file)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
        file.write_text(json.dumps(_this_run()), encoding="utf-8")
    except Timeout:
        raise GapscopeError(
            f"{folder}: another run writes to this folder{_holder(file)}",
            "wait for its end, or choose another folder with --out",
        ) from None
    except OSError as error:
        lock.release()
        raise GapscopeError(
            f"{folder}: cannot be written to ({error.strerror})",
            "choose another folder with --out, or check the folder's permissions",
        ) from None
    try:
        yield
    finally:
        # removed while it is held: who waits for it sees that and makes a new one
        with suppress(OSError):
            file.unlink(missing_ok=True)
        lock.release()
        if made:
            with suppress(OSError):  # holds results
                folder.rmdir()


def _this_run() -> dict[str, str | int]:
    """What another run is told about this one."""
    command = " ".join(["gapscope", *sys.argv[1:]])
    since = datetime.now().astimezone().isoformat(" ", "seconds")
    here = socket.gethostname()
    return {"pid": os.getpid(), "host": here, "since": since, "command": command}


def _holder(file: Path) -> str:
    """Who holds a lock, in words; empty if its file does not tell (yet)."""
    try:
        run = json.loads(file.read_text(encoding="utf-8"))
        return f": process {run['pid']} on {run['host']} since {run['since']}, {run['command']}"
    except (OSError, ValueError, KeyError, TypeError):
        return ""


# The ``locked:`` section of a case: where joints stand that are none of the arm's.


def locked_positions(content: Mapping[str, Any], paths: CasePaths) -> dict[str, float]:
    """Positions of locked joints [rad or m], by name.

    A number is the position; a text names a column of the first recording, whose mean is taken.

    Raises:
        InputError: no table of that recording has the column.
    """
    section = content.get("locked") or {}
    columns = {name: entry for name, entry in section.items() if isinstance(entry, str)}
    positions = {name: entry for name, entry in section.items() if name not in columns}
    if not columns:
        return {name: float(position) for name, position in positions.items()}
    first = paths.entry(content["recordings"][0], "recordings")
    files = [first] if not isinstance(first, dict) else list(first.values())
    tables = [table.table for file in files for table in open_log(file).tables]
    for name, column in columns.items():
        holding = [table for table in tables if column in table.columns]
        if not holding:
            raise InputError(
                f"no table of {', '.join(str(file) for file in files)} has a column {column!r}",
                "name a column, or give the position as a number",
                file=paths.file,
                where=f"field locked.{name}",
            )
        positions[name] = np.mean(holding[0].numbers(column))
    return {name: float(positions[name]) for name in section}
