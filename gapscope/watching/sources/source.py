"""What every source of samples does: it gives what is new, and remembers where it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from gapscope.arm.errors import InputError
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.log import READERS
from gapscope.arm.io.samples.damaged import DAMAGED, PAUSE
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.watching.alarm import NOTE, Event


class Source(Protocol):
    """Samples of an arm, part by part as they come.

    Attributes:
        unfinished: whether something is there that may not be whole yet.
    """

    unfinished: bool

    def poll(self) -> Iterator[Recording | Event]:
        """What is new since the last call: parts of recordings in the order of time, and notes about the source."""

    def position(self) -> dict[str, Any]:
        """Where it is, as data for JSON; right between two items of ``poll``."""


class Reading:
    """How the files of a source become recordings, and what went wrong with them so far.

    Args:
        arm: the nominal arm.
        importing: the case's import section.

    Attributes:
        failure: the first file or row that could not be used while nothing else was, or ``None``.
    """

    def __init__(self, arm: NominalArm, importing: Import | None) -> None:
        self.arm, self.importing = arm, importing
        self.failure: InputError | None = None
        self.succeeded = False

    def note(self, error: InputError) -> Event:
        """The note on something that cannot be used; the watch goes on without it."""
        if not self.succeeded and self.failure is None:
            self.failure = error
        return Event(event=NOTE, sentence=f"left out: {error}")

    def damage(self, recording: Recording, file: Path) -> Iterator[Event]:
        """Notes on rows of a file that could not be read."""
        for said in recording.notes:
            if said.startswith((DAMAGED, PAUSE)):
                yield Event(event=NOTE, sentence=f"{file}: {said}")


def is_text(path: Path) -> bool:
    """Whether a file holds a row of samples in each line, so that its beginning can be used while it grows."""
    return path.suffix.lower() in (".csv", ".tsv", ".txt")


def check_readable(path: Path) -> None:
    """Check that a path exists, and may hold recordings.

    Raises:
        InputError: it does not.
    """
    if not path.exists():
        raise InputError(
            "no such file or folder", "start the recording first", file=path
        )
    if path.is_file() and path.suffix.lower() not in READERS:
        raise InputError(
            f"the ending {path.suffix!r} names no known format",
            f"give a file that ends in {', '.join(READERS)}, or a folder of such files",
            file=path,
        )
