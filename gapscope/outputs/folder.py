"""Folders of results: made before the work starts, and free of the document of an earlier run."""

from __future__ import annotations

import os
from pathlib import Path

from gapscope.arm.errors import GapscopeError


def make_folder(folder: Path) -> None:
    """Make a folder that can be written to, before any work is done for it.

    Raises:
        GapscopeError: it cannot be made or written to.
    """
    probe = folder / f".gapscope-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
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
