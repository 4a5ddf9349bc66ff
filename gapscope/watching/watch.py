"""Where a watch reads from: folders and growing files, as recordings."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.lerobot import is_dataset
from gapscope.arm.io.formats.table_files import remarks, table_of_lines
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import READERS, TEXTS
from gapscope.arm.io.table import DAMAGED, PAUSE, Log
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.provenance import fingerprint
from gapscope.watching.detector import (
    ALARM,
    EVENTS,
    MISFIT,
    NOTE,
    STATE,
    Detector,
    Event,
    EventFile,
    Saved,
    WatchSettings,
    load_state,
    save_state,
)


class Reading:
    """How the files of a source become recordings, and what went wrong with them so far.

    Args:
        arm: the nominal arm.
        importing: the case's import section.
        payload_of: known body that was mounted in the recording of a file.

    Attributes:
        failure: the first file or row that could not be used while nothing else was, or ``None``.
    """

    def __init__(
        self,
        arm: NominalArm,
        importing: Import | None,
        payload_of: Callable[[Path], KnownLoad | None] = lambda _: None,
    ) -> None:
        self.arm, self.importing, self.payload_of = arm, importing, payload_of
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


def check_readable(path: Path) -> None:
    """Check that a path exists, and may hold recordings.

    Raises:
        InputError: it does not.
    """
    if not path.exists():
        raise InputError(
            "no such file or folder", "start the recording first", file=path
        )
    if is_dataset(path):
        raise _of_dataset(path)
    if path.is_file() and path.suffix.lower() not in READERS:
        raise InputError(
            f"the ending {path.suffix!r} names no known format",
            f"give a file that ends in {', '.join(READERS)}, or a folder of such files",
            file=path,
        )


# A text file that grows, a row of samples in each line: read up to its last whole line.


MAX_BYTES = 2**20
"""Size that is read at once [bytes]: bounds the memory when a long file is caught up with."""
FEWEST_LINES = 50
"""Lines that are read together at least, fewer wait for more or for the end: they hardly show a rate."""


class GrowingFile:
    """Follows a CSV file.

    A last line without its end waits for the rest. A file that shrank was begun anew and is read from its start. A file
    of another inode under the same name took its place, as log rotation does: the rest of the old one is read first.

    Args:
        path: the file.
        reading: how its rows become a recording.
        rest: time without a write after which the last few lines wait for no more [s].
        position: where an earlier run ended, or ``None``.

    Attributes:
        unfinished: whether the last few lines wait for more.
    """

    def __init__(
        self,
        path: Path,
        reading: Reading,
        rest: float,
        position: Mapping[str, Any] | None = None,
    ) -> None:
        self.path, self.reading, self.rest = path, reading, rest
        self.unfinished = False
        # held open: a file that is rotated away can be read to its end
        self._file: BinaryIO = path.open("rb")
        self._header, self._line, self._part = "", 1, 1
        if position is not None:
            state = os.fstat(self._file.fileno())
            self._part = int(position["part"])
            same = state.st_ino == position["inode"]
            # shorter than where it was left, it is not the same file
            if same and state.st_size >= position["offset"]:
                self._file.seek(position["offset"])
                self._line, self._header = (
                    int(position["line"]),
                    str(position["header"]),
                )
            else:
                # another file under the name is another recording
                self._part += 1

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
        written = os.fstat(self._file.fileno()).st_mtime
        # the rest of the file that was open, whatever has its name by then
        yield from self._rows(ended=time.time() - written >= self.rest)
        try:
            now = self.path.stat()
        except FileNotFoundError:
            # between the two steps of a rotation
            return
        if now.st_ino != os.fstat(self._file.fileno()).st_ino:
            yield from self._rows(ended=True)
            yield self._anew(
                "another file took its place, which is read from its start"
            )
        elif now.st_size < self._file.tell():
            yield self._anew("it was cut, and is read from its start")
        else:
            return
        yield from self._rows(ended=False)

    def _anew(self, why: str) -> Event:
        self._file.close()
        self._file = self.path.open("rb")
        self._header, self._line = "", 1
        self._part += 1
        return Event(event=NOTE, sentence=f"{self.path}: {why}")

    def _rows(self, *, ended: bool) -> Iterator[Recording | Event]:
        """The whole lines that were added, in parts of at most ``MAX_BYTES``; the last few once the file ended."""
        while True:
            start = self._file.tell()
            raw = self._file.read(MAX_BYTES)
            # what follows the last end of a line waits
            whole = raw[: raw.rfind(b"\n") + 1]
            lines = whole.count(b"\n")
            more = len(raw) == MAX_BYTES
            # too few lines wait for more, but for a buffer that is full; one row alone has no rate
            rows = lines if self._header else lines - 1
            few = lines < FEWEST_LINES and not more
            self.unfinished = few and rows > 1 and not ended
            if not whole or self.unfinished or (few and rows < 2):
                self._file.seek(start)
                if more:
                    # the note on a line without end, which is left out
                    self._file.seek(0, os.SEEK_END)
                    yield self._note(
                        f"has a line of more than {MAX_BYTES} bytes", self._line
                    )
                return
            self._file.seek(start + len(whole))
            yield from self._recording(whole, lines)

    def _recording(self, whole: bytes, lines: int) -> Iterator[Recording | Event]:
        """Whole lines as a part of a recording, or why they are none."""
        first = self._line
        # lines count whether they can be used or not, so that notes name the right ones
        self._line += lines
        # a mark of the byte order may stand at the beginning; a row with a wrong byte is damaged
        text = whole.decode("utf-8-sig", errors="replace").splitlines(keepends=True)
        named = 1
        # the first whole line below remarks names the columns
        if not self._header:
            above = remarks(text)
            self._header, *text = text[above:]
            named += above
            first = named + 1
        if not text:
            return
        try:
            table = table_of_lines(self._header, text, self.path, first, named)
            log = Log(self.path, "CSV", (replace(table, kind="CSV"),))
            part = load_recording(log, self.reading.arm, self.reading.importing)
        except InputError as error:
            yield self.reading.note(error)
            return
        yield from self.reading.damage(part, self.path)
        self.reading.succeeded = True
        # parts of a file that was begun anew are not joined
        name = self.path.name if self._part == 1 else f"{self.path.name} ({self._part})"
        # every part goes on by the clock of the log
        yield replace(part, name=name, t=part.stamps, begun=0.0)

    def _note(self, what: str, line: int) -> Event:
        error = InputError(what, file=self.path, where=f"from line {line} on")
        return self.reading.note(error)


# A folder in which recordings appear: files of any format, ROS bags file by file, each read once it is complete.


BAGS = (".db3", ".mcap")
"""Endings of the files of a ROS bag; one that is split has several, numbered in the order of time."""
SPLIT = re.compile(r"(.*)_(\d+)\.\w+")
"""Name of a file of a bag, with its number."""
READ = -1
"""Stands in place of the size of a file that was read."""
METADATA = "metadata.yaml"
"""Written beside the files of a bag when its recording ends."""


class Folder:
    """Follows a folder, or one file that is written at once.

    A file counts as complete if nothing was written to it for ``rest`` seconds, if a later file of the same split bag
    exists, or if the bag's ``metadata.yaml`` does. Hidden files are left alone, and those whose ending is no
    recording's, so that a writer may use another name and rename at the end. Folders below are looked into, to one
    level.

    A file that cannot be read is tried again when its size changes.

    Args:
        path: of the folder or file.
        reading: how files become recordings.
        rest: time without a write after which a file is complete [s].
        position: where an earlier run ended, or ``None``.
        without: a folder that is none of the source's, such as that of the results.

    Attributes:
        unfinished: whether the last call of ``poll`` left out a file that may not be whole yet.
    """

    def __init__(
        self,
        path: Path,
        reading: Reading,
        rest: float,
        position: Mapping[str, Any] | None = None,
        without: Path | None = None,
    ) -> None:
        self.path, self.reading, self.rest = path, reading, rest
        self._without = None if without is None else without.resolve()
        self.unfinished = False
        done = {} if position is None else position["done"]
        self._done: dict[str, int] = {str(k): int(v) for k, v in done.items()}

    def position(self) -> dict[str, Any]:
        """Files that were read, or tried at some size [bytes]; those that are gone are forgotten."""
        return {"done": dict(self._done)}

    def poll(self) -> Iterator[Recording | Event]:
        """The recordings that have become complete, in the order of their names."""
        files = self._files()
        present = {self._key(file) for file in files}
        self._done = {k: v for k, v in self._done.items() if k in present}
        self.unfinished = False
        for file in files:
            # it may have gone since the folder was read
            if not file.exists():
                continue
            if not self._is_complete(file, files):
                # what was read and is written to again is not waited for
                self.unfinished |= self._done.get(self._key(file)) != READ
                continue
            key, size = self._key(file), file.stat().st_size
            tried = self._done.get(key)
            # read, or tried at this size: another try needs another size
            if tried in (READ, size):
                continue
            item = self._read(file)
            self._done[key] = READ if isinstance(item, Recording) else size
            if isinstance(item, Recording):
                yield from self.reading.damage(item, file)
            yield item

    def _read(self, file: Path) -> Recording | Event:
        if is_dataset(file):
            return self.reading.note(_of_dataset(file))
        try:
            found = load_recording(
                file,
                self.reading.arm,
                self.reading.importing,
                payload=self.reading.payload_of(file),
            )
        except InputError as error:
            return self.reading.note(error)
        self.reading.succeeded = True
        return found.part(slice(None), name=self._key(file))

    def _key(self, file: Path) -> str:
        """Name of a file within the source."""
        return (
            file.name if file == self.path else file.relative_to(self.path).as_posix()
        )

    def _files(self) -> list[Path]:
        """All files that may hold a recording, by name, with numbers in them by value."""
        if self.path.is_file():
            return [self.path]
        found = []
        try:
            entries = list(self.path.iterdir())
        except OSError as error:
            raise InputError(
                f"cannot be looked into any more ({error.strerror})",
                "start the watch again when the folder is back: it goes on where it ended",
                file=self.path,
            ) from None
        for entry in entries:
            if entry.name.startswith(".") or entry.resolve() == self._without:
                continue
            # files of a dataset are no recordings by themselves
            if entry.is_dir() and not is_dataset(entry):
                found += [f for f in entry.iterdir() if not f.name.startswith(".")]
            else:
                found.append(entry)
        recordings = [
            f
            for f in found
            if is_dataset(f) or (f.suffix.lower() in READERS and f.is_file())
        ]
        return sorted(recordings, key=_natural)

    def _is_complete(self, file: Path, files: list[Path]) -> bool:
        if time.time() - file.stat().st_mtime >= self.rest:
            return True
        split = SPLIT.fullmatch(file.name)
        if split is None or file.suffix.lower() not in BAGS:
            return False
        if (file.parent / METADATA).exists():
            return True
        # of a split bag the next file is begun when this one is closed
        following = f"{split[1]}_{int(split[2]) + 1}{file.suffix}"
        return file.with_name(following) in files


def _of_dataset(folder: Path) -> InputError:
    """Why a dataset is left out: it holds many recordings, which are not made while it is watched."""
    return InputError(
        "is a LeRobot dataset, which is not watched",
        "name it under recordings: of a case, and diagnose that",
        file=folder,
    )


def _natural(file: Path) -> list[tuple[int, str]]:
    """Sort key of a path: numbers in it by value, so that part 10 comes after part 9."""
    parts = re.split(r"(\d+)", str(file))
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts]


SAVE_EVERY = 30.0
"""Time after which a state is saved that changed [s]; after every alarm and misfit as well."""


POLL = 0.5
"""Time between two looks at a source in which nothing is new [s]. (budget)"""


class Watch:
    """A source that is watched with an arm.

    Args:
        corrected: the arm with its effects.
        settings: what the user chooses.
        case: how files are read, and known bodies they had mounted; ``None``: in the columns of the case format.

    Attributes:
        read: names of the recordings that were read.
        resumed: whether it goes on with what an earlier run learnt.

    Raises:
        InputError: source, settings or state cannot be used.
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        settings: WatchSettings,
        case: Case | None = None,
    ) -> None:
        check_readable(settings.source)
        self.settings = settings
        self.detector = Detector(corrected, settings.false_alarms, settings.learning)
        self.alarms = self.misfits = 0
        self.read: set[str] = set()
        self.resumed = False
        self._arm = fingerprint((corrected, settings.learning))
        earlier = self._earlier()
        self._reading = Reading(corrected.arm, None)
        if case:
            self._reading = Reading(corrected.arm, case.importing, case.payload_of)
        self._first: list[Event] = []
        # with 0 s to learn from, the case says what is normal, if no earlier run did
        if not (settings.learning or self.resumed):
            recordings = case.recordings if case else ()
            told = [one for one in recordings if one.tau is not None]
            self._first += self.detector.learn_from(told)
        path, out = settings.source, settings.out
        self._place = str(path.resolve())
        # in another source a later run begins anew, with what was learnt
        same = earlier is not None and earlier.source == self._place
        position = earlier.position if earlier and same else None
        self.source: GrowingFile | Folder
        # rows of text can be used while their file grows
        if path.is_file() and path.suffix.lower() in TEXTS:
            self.source = GrowingFile(path, self._reading, settings.rest, position)
        else:
            self.source = Folder(path, self._reading, settings.rest, position, out)
        self._events = None
        if settings.out is not None:
            count = earlier.count if earlier else 0
            self._events = EventFile(settings.out / EVENTS, count)

    def run(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Events as they happen, until the source has rested for ``until_idle`` or ``stopped`` says so.

        For the first ``rest`` seconds it does not end while a file is there that may not be whole yet.

        Raises:
            InputError: the source ended, and nothing of it could be used.
        """
        yield from self._said(iter(self._first))
        begun = idle_since = saved = time.monotonic()
        until_idle = self.settings.until_idle
        while not stopped():
            new = False
            for item in self.source.poll():
                new, before = True, self.alarms + self.misfits
                yield from self._said(self._events_of(item))
                late = time.monotonic() - saved > SAVE_EVERY
                # after an alarm at once: a later run is not to tell it again
                if late or self.alarms + self.misfits > before:
                    self._save()
                    saved = time.monotonic()
                # what a source notes comes before the recording that it counts as read
                if stopped() and isinstance(item, Recording):
                    break
            now = time.monotonic()
            idle_since = now if new else idle_since
            # a file that was there at the start gets the time to become complete
            waits = self.source.unfinished and now - begun < self.settings.rest
            idle = until_idle is not None and now - idle_since >= until_idle
            if idle and not waits:
                break
            if not new:
                time.sleep(POLL)
        # asked to stop it stops at once: the next run goes on
        if not stopped():
            yield from self._said(self.detector.last_look())
        self._save()
        failure = self._reading.failure
        # an end without anything that could be read is a failure of the source
        if failure is not None and not self._reading.succeeded:
            raise failure

    def _events_of(self, item: Recording | Event) -> Iterator[Event]:
        if isinstance(item, Event):
            yield item
            return
        self.read.add(item.name)
        if item.tau is None:
            yield Event(event=NOTE, sentence=f"{item.name}: has no torque, left out")
        yield from self.detector.add(item)
        # a file of a folder is complete
        if isinstance(self.source, Folder):
            yield from self.detector.ended()

    def _said(self, events: Iterator[Event]) -> Iterator[Event]:
        """The events, written to the file before they are passed on."""
        for event in events:
            if self._events is not None:
                self._events.write(event)
            if event.event == ALARM:
                self.alarms += 1
            if event.event == MISFIT:
                self.misfits += 1
            yield event

    def _earlier(self) -> Saved | None:
        """What an earlier run left, if it watched the same arm."""
        out = self.settings.out
        if out is None or not (out / STATE).is_file():
            return None
        earlier = load_state(out / STATE, self.detector, self._arm)
        # a state without motion has learnt nothing
        self.resumed = earlier is not None and bool(self.detector.state.blocks)
        return earlier

    def _save(self) -> None:
        out = self.settings.out
        if out is None or self._events is None:
            return
        left = self._arm, self._place, self.source.position(), self._events.count
        save_state(out / STATE, self.detector, *left)
