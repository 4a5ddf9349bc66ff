"""Events in a file, one JSON line each, appended."""

from __future__ import annotations

import os
from pathlib import Path

from gapscope.arm.errors import GapscopeError
from gapscope.watching.alarm import Event

EVENTS = "events.jsonl"
"""Name of the file in the folder of the results."""


class EventFile:
    """Appends events; each is on the disk before the next one.

    Args:
        path: of the file.
        count: events of earlier runs.

    Raises:
        GapscopeError: the file cannot be written.
    """

    def __init__(self, path: Path, count: int) -> None:
        self.path, self.count = path, count
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        except OSError as error:
            raise self._cannot(error) from None

    def write(self, event: Event) -> None:
        """Append one line."""
        line = event.as_line(self.count + 1) + "\n"
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise self._cannot(error) from None
        self.count += 1

    def _cannot(self, error: OSError) -> GapscopeError:
        return GapscopeError(
            f"{self.path}: cannot be written ({error.strerror})",
            "choose another folder, or check the permissions of this one",
        )
