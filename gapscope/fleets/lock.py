"""One run at a time in a folder of results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from gapscope.arm.errors import GapscopeError


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, which exists, for this process; the system lets go of it when the process ends, however it does.

    Raises:
        GapscopeError: another process holds it.
    """
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise GapscopeError(
            f"{folder}: another run writes to this folder",
            "wait for its end, or choose another folder with --out",
        ) from None
    try:
        yield
    finally:
        lock.release()
