"""All diagnoses below a folder, read again only if their files have changed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from threading import Lock

from gapscope.archive.entry import CASE, UNITS_BY, Entry, read_entry, unreadable
from gapscope.arm.errors import InputError
from gapscope.diagnosis.document.diagnosis_json import read_document

DOCUMENT, REPORT = "diagnosis.json", "report.html"
LARGEST = 50_000_000
"""Files that are larger are no diagnosis, which has some 100 kB [bytes]."""
_OTHER_VERSION = (LookupError, TypeError, ValueError, ArithmeticError)
"""What a document of the schema can still lead to; it must not hide the others."""
_State = tuple[int, int, bool]
"""Time of the last change [ns], size [bytes], and whether there is a report."""


class Archive:
    """The diagnoses below a folder, at any depth.

    Hidden folders and links to folders are not entered. ``entries`` may be called from several threads.
    """

    def __init__(self, root: Path, units_by: str = CASE) -> None:
        """Take a folder; nothing is read yet.

        Raises:
            InputError: it is no folder, or ``units_by`` is neither ``case`` nor ``folder``.
        """
        if units_by not in UNITS_BY:
            raise InputError(f"{units_by} names no unit", "use case or folder")
        if not root.is_dir():
            remedy = "give the folder in which gapscope diagnose wrote its results"
            raise InputError("is not a folder", remedy, file=root)
        self.root = root.resolve()
        self.units_by = units_by
        self._known: dict[Path, tuple[_State, Entry]] = {}
        self._lock = Lock()

    def entries(self, progress: Callable[[str], None] | None = None) -> list[Entry]:
        """All diagnoses as they are now, the latest first."""
        with self._lock:
            known: dict[Path, tuple[_State, Entry]] = {}
            lost: list[Entry] = []
            for file, has_report in self._files(lost):
                known[file] = self._current(file, has_report)
                if progress and len(known) % 100 == 0:
                    progress(f"{len(known)} diagnoses")
            self._known = known
        entries = [entry for _, entry in known.values()] + lost
        return sorted(entries, key=lambda entry: (entry.date, entry.folder))[::-1]

    def _files(self, lost: list[Entry]) -> Iterator[tuple[Path, bool]]:
        """Every ``diagnosis.json``, and whether a report is beside it; folders that cannot be read go to ``lost``."""

        def closed(error: OSError) -> None:
            place = self._place(Path(error.filename))
            lost.append(unreadable(place, datetime.now(), f"folder: {error.strerror}"))

        for folder, folders, files in os.walk(self.root, onerror=closed):
            folders[:] = [name for name in folders if not name.startswith(".")]
            if DOCUMENT in files:
                yield Path(folder, DOCUMENT), REPORT in files

    def _current(self, file: Path, has_report: bool) -> tuple[_State, Entry]:
        """State and entry of a file: those known if it has not changed."""
        try:
            found = file.stat()
        except OSError as error:  # removed just now, or a link that leads nowhere
            problem = f"cannot be read ({error.strerror})"
            lost = unreadable(self._place(file.parent), datetime.now(), problem)
            return (0, 0, has_report), lost
        state = (found.st_mtime_ns, found.st_size, has_report)
        known = self._known.get(file)
        if known and known[0] == state:
            return known
        return state, self._read(file, state)

    def _read(self, file: Path, state: _State) -> Entry:
        nanoseconds, size, has_report = state
        changed = datetime.fromtimestamp(nanoseconds / 1e9)
        place = self._place(file.parent)
        problem = self._refusal(file, size)
        if problem:
            return unreadable(place, changed, problem)
        try:
            document = read_document(file)
            return read_entry(
                document, place, changed, units_by=self.units_by, has_report=has_report
            )
        except InputError as error:
            problem = error.problem
        except RecursionError:
            problem = "is nested too deeply"
        except _OTHER_VERSION as error:
            problem = f"is of another version of Gapscope ({error!r})"
        return unreadable(place, changed, problem)

    def _refusal(self, file: Path, size: int) -> str:
        """Why a file is not read at all; empty if it is."""
        if not file.resolve().is_relative_to(self.root):
            return "is a link that leaves the folder"
        if not file.is_file():
            return "is not a file"
        return "is too large for a diagnosis" if size > LARGEST else ""

    def _place(self, folder: Path) -> str:
        return folder.relative_to(self.root).as_posix()
