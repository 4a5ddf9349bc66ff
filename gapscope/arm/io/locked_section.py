"""Folders locked while they are used: one run at a time, by a lock that the system lets go of when its process ends."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from gapscope.arm.errors import GapscopeError

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
    if folder is None:
        yield
        return
    made, file = not folder.exists(), folder / LOCK
    lock = FileLock(file)
    # what another run is told about this one
    run = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now().astimezone().isoformat(" ", "seconds"),
        "command": " ".join(["gapscope", *sys.argv[1:]]),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # not waited for: the other run may take hours
        lock.acquire(timeout=0)
        file.write_text(json.dumps(run), encoding="utf-8")
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


def _holder(file: Path) -> str:
    """Who holds a lock, in words; empty if its file does not tell (yet)."""
    try:
        run = json.loads(file.read_text(encoding="utf-8"))
        return f": process {run['pid']} on {run['host']} since {run['since']}, {run['command']}"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
