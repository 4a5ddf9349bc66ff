"""A text file that grows, a row of samples in each line: read up to its last whole line."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.table_files import table_of_lines
from gapscope.arm.io.load_recording import recording_of_log
from gapscope.arm.io.log_table import Log, LogTable
from gapscope.arm.recording import Recording
from gapscope.watching.alarm import NOTE, Event
from gapscope.watching.sources.source import Reading

MOST_BYTES = 2**20
"""Size that is read at once [bytes]: bounds the memory when a long file is caught up with."""
FEWEST_LINES = 50
"""Lines that are read together at least, fewer wait for more: they would not show a rate."""


class GrowingFile:
    """Follows a CSV file.

    A last line without its end waits for the rest. A file that shrank was begun anew and is read from its start. A file
    of another inode under the same name took its place, as log rotation does: the rest of the old one is read first.

    Args:
        path: the file.
        reading: how its rows become a recording.
        position: where an earlier run ended, or ``None``.
    """

    unfinished = False
    """Its rows are used as they come."""

    def __init__(
        self, path: Path, reading: Reading, position: Mapping[str, Any] | None = None
    ) -> None:
        self.path, self.reading = path, reading
        self._file: BinaryIO = path.open("rb")
        self._header, self._line, self._part = "", 1, 1
        if position is not None:
            self._resume(position)

    def position(self) -> dict[str, Any]:
        """Inode, place in the file after the last row that was used, number of its line, and of the file."""
        return {
            "inode": os.fstat(self._file.fileno()).st_ino,
            "offset": self._file.tell(),
            "line": self._line,
            "part": self._part,
            "header": self._header,
        }

    def poll(self) -> Iterator[Recording | Event]:
        """Rows that were added, and notes if the file was begun anew."""
        yield from self._rows()
        try:
            now = self.path.stat()
        except FileNotFoundError:
            # between the two steps of a rotation
            return
        if now.st_ino != os.fstat(self._file.fileno()).st_ino:
            yield self._anew(
                "another file took its place, which is read from its start"
            )
        elif now.st_size < self._file.tell():
            yield self._anew("it was cut, and is read from its start")
        else:
            return
        yield from self._rows()

    def _resume(self, position: Mapping[str, Any]) -> None:
        state = os.fstat(self._file.fileno())
        self._part = int(position["part"])
        same = state.st_ino == position["inode"]
        if same and state.st_size >= position["offset"]:
            self._file.seek(position["offset"])
            self._line, self._header = int(position["line"]), str(position["header"])
        else:
            self._part += 1

    def _anew(self, why: str) -> Event:
        self._file.close()
        self._file = self.path.open("rb")
        self._header, self._line = "", 1
        self._part += 1
        return Event(event=NOTE, sentence=f"{self.path}: {why}")

    def _rows(self) -> Iterator[Recording | Event]:
        """The whole lines that were added, in parts of at most ``MOST_BYTES``."""
        while True:
            start = self._file.tell()
            raw = self._file.read(MOST_BYTES)
            whole = raw[: raw.rfind(b"\n") + 1]
            lines = whole.count(b"\n")
            more = len(raw) == MOST_BYTES
            if not whole or (lines < FEWEST_LINES and not more):
                self._file.seek(start)
                if more:
                    yield self._too_long()
                return
            self._file.seek(start + len(whole))
            yield from self._recording(whole, lines)

    def _recording(self, whole: bytes, lines: int) -> Iterator[Recording | Event]:
        """Whole lines as a part of a recording, or why they are none."""
        first = self._line
        self._line += lines
        try:
            text = whole.decode("utf-8-sig").splitlines(keepends=True)
        except UnicodeDecodeError:
            yield self._note("is not a text in UTF-8", first)
            return
        if not self._header:
            self._header, *text = text
            first += 1
        if not text:
            return
        try:
            table = table_of_lines(self._header, text, self.path, first)
            log = Log(self.path, "CSV", (LogTable("", "CSV", table),))
            part = recording_of_log(log, self.reading.arm, self.reading.importing)
        except InputError as error:
            yield self.reading.note(error)
            return
        yield from self.reading.damage(part, self.path)
        self.reading.succeeded = True
        name = self.path.name if self._part == 1 else f"{self.path.name} ({self._part})"
        # every part goes on by the clock of the log
        yield replace(part, name=name, t=part.stamps, begun=0.0)

    def _note(self, what: str, line: int) -> Event:
        error = InputError(what, file=self.path, where=f"from line {line} on")
        return self.reading.note(error)

    def _too_long(self) -> Event:
        """The note on a line without end, which is left out."""
        self._file.seek(0, os.SEEK_END)
        return self._note(f"has a line of more than {MOST_BYTES} bytes", self._line)
