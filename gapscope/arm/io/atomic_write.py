"""Files written whole or not at all, and folders of results, free of an earlier run."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gapscope.arm.errors import GapscopeError

# Files that are written whole or not at all: under a temporary name beside the place, then renamed.


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """A temporary path to write to, with the same ending; it becomes ``path`` when the block ends without error.

    Makes the folder. Raises:
        GapscopeError: ``path`` cannot be written.
    """
    path = Path(path)
    # beside the place, on the same file system: renaming is then one step
    aside = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield aside
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{path}: cannot be written ({error.strerror})",
            "choose another folder, or check the permissions of this one",
        ) from None


def write_text(path: Path | str, text: str) -> None:
    """Write a text in UTF-8 whole or not at all.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


@contextmanager
def folder_aside(place: Path) -> Iterator[Path]:
    """A hidden temporary folder beside a place, on the same file system, that goes when the block ends.

    If the place has turned read-only it stays (``tempfile.TemporaryDirectory`` recurses without end there). Raises:
        OSError: it cannot be made.
    """
    aside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    try:
        yield aside
    finally:
        shutil.rmtree(aside, ignore_errors=True)


# Folders of results: made before the work starts, and free of the document of an earlier run.


def make_folder(folder: Path) -> None:
    """Make a folder that can be written to, before any work is done for it.

    Raises:
        GapscopeError: it cannot be made or written to.
    """
    probe = folder / f".gapscope-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # by trying: permissions alone do not tell whether a disk is full or read-only
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise GapscopeError(
            f"{folder}: cannot be written to ({error.strerror})",
            "choose another folder with --out, or check the folder's permissions",
        ) from None


def begin_results(folder: Path, document: str) -> None:
    """Make a folder and remove the document of an earlier run.

    The document is written last, so one that is there is complete and of this run.

    Args:
        folder: of the results.
        document: name of the file that is written last.

    Raises:
        GapscopeError: the folder cannot be written to, or the document cannot be removed.
    """
    make_folder(folder)
    try:
        (folder / document).unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{folder / document}: cannot be replaced ({error.strerror})", "remove it"
        ) from None
