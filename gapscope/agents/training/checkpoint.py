"""Checkpoints: folders that are written whole, with hashes, and never half read."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import to_json
from gapscope.provenance import sha256

MANIFEST, STATE = "manifest.json", "state.json"
_PREFIX = "round_"
_REMEDY = "remove that folder to resume from the round before, if it is there, or train from the start with --again"


@contextmanager
def written_checkpoint(
    folder: Path, number: int, state: dict[str, Any]
) -> Iterator[Path]:
    """A folder to write the files of a round into; it becomes the checkpoint when the block ends without error.

    Args:
        folder: of all checkpoints; only the newest one is kept.
        number: rounds that are done.
        state: plain data, written as ``state.json``.

    Raises:
        GapscopeError: it cannot be written.
    """
    aside, place = folder / f".{os.getpid()}", folder / f"{_PREFIX}{number:05d}"
    try:
        for left in folder.glob(".*"):  # by a process that was killed
            shutil.rmtree(left)
        aside.mkdir(parents=True)
        try:
            yield aside
            (aside / STATE).write_text(to_json(state), encoding="utf-8")
            hashes = {path.name: sha256(path) for path in sorted(aside.iterdir())}
            (aside / MANIFEST).write_text(to_json(hashes), encoding="utf-8")
            aside.replace(place)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        for older in _all(folder):
            if older != place:
                shutil.rmtree(older)
    except OSError as error:
        raise GapscopeError(
            f"{place}: cannot be written ({error.strerror})",
            "choose another folder, or check the permissions of this one",
        ) from None


def read_checkpoint(folder: Path) -> tuple[Path, dict[str, Any]] | None:
    """Folder and state of the newest checkpoint, or ``None`` if there is none.

    Raises:
        InputError: a file of it is missing, was cut short or changed.
    """
    found = _all(folder)
    if not found:
        return None
    newest = found[-1]
    try:
        hashes = json.loads((newest / MANIFEST).read_text(encoding="utf-8"))
        for name, digest in hashes.items():
            if sha256(newest / name) != digest:
                raise InputError(
                    "was cut short or changed", _REMEDY, file=newest / name
                )
        return newest, json.loads((newest / STATE).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"is not whole ({error.strerror}: {error.filename})", _REMEDY, file=newest
        ) from None
    except (ValueError, AttributeError) as error:
        raise InputError(
            f"is not whole ({error})", _REMEDY, file=newest / MANIFEST
        ) from None


def _all(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"{_PREFIX}*")) if folder.is_dir() else []
