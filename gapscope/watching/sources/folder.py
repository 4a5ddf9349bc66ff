"""A folder in which recordings appear: files of any format, ROS bags file by file, each read once it is complete."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.lerobot import is_dataset
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import READERS
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import Recording
from gapscope.watching.alarm import Event
from gapscope.watching.sources.source import Reading

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
        payload_of: known body that was mounted in the recording of a file.

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
        payload_of: Callable[[Path], KnownLoad | None] = lambda _: None,
    ) -> None:
        self.path, self.reading, self.rest = path, reading, rest
        self._without = None if without is None else without.resolve()
        self._payload_of = payload_of
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
            if not file.exists():
                continue
            if not self._is_complete(file, files):
                self.unfinished |= self._done.get(self._key(file)) != READ
                continue
            key, size = self._key(file), file.stat().st_size
            tried = self._done.get(key)
            if tried in (READ, size):
                continue
            item = self._read(file)
            self._done[key] = READ if isinstance(item, Recording) else size
            if isinstance(item, Recording):
                yield from self.reading.damage(item, file)
            yield item

    def _read(self, file: Path) -> Recording | Event:
        try:
            found = load_recording(
                file,
                self.reading.arm,
                self.reading.importing,
                payload=self._payload_of(file),
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
            if entry.is_dir() and not is_dataset(entry):
                found += [f for f in entry.iterdir() if not f.name.startswith(".")]
            else:
                found.append(entry)
        files = [f for f in found if f.suffix.lower() in READERS and f.is_file()]
        return sorted(files, key=_natural)

    def _is_complete(self, file: Path, files: list[Path]) -> bool:
        if time.time() - file.stat().st_mtime >= self.rest:
            return True
        split = SPLIT.fullmatch(file.name)
        if split is None or file.suffix.lower() not in BAGS:
            return False
        if (file.parent / METADATA).exists():
            return True
        following = f"{split[1]}_{int(split[2]) + 1}{file.suffix}"
        return file.with_name(following) in files


def _natural(file: Path) -> list[tuple[int, str]]:
    """Sort key of a path: numbers in it by value, so that part 10 comes after part 9."""
    parts = re.split(r"(\d+)", str(file))
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts]
