"""What a diagnosis was made from, so that a run that was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from arm.case import case_files
from arm.errors import GapscopeError
from diagnosis.blind.frozen import LIBRARIES, source_hash
from diagnosis.document import validate

KEY = "made_from"
"""Key of ``diagnosis.json``."""
BESIDE = ("corrected.yaml", "report.html")
"""Files that are written before ``diagnosis.json``."""


def made_from(path: Path) -> dict[str, str]:
    """SHA-256 of the case's files, names and contents, and of the program: its source, Python and the libraries.

    Raises:
        InputError: the case file, the robot or a recording cannot be read.
    """
    digest = hashlib.sha256()
    for file in case_files(path):
        try:
            content = hashlib.sha256(file.read_bytes()).digest()
        except OSError as error:
            raise GapscopeError(f"{file}: cannot be read ({error.strerror})", "check the path") from None
        digest.update(file.name.encode() + b"\0" + content)
    return {"case_sha256": digest.hexdigest(), "program_sha256": program()}


def kept(case: Path, folder: Path) -> dict[str, Any] | None:
    """The diagnosis in a folder, where it is whole and made from this case as it is now, by this program."""
    try:
        content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        validate(content)
        whole = all((folder / name).is_file() for name in BESIDE)
        return content if whole and content.get(KEY) == made_from(case) else None
    except (OSError, ValueError, GapscopeError):
        return None


@cache
def program() -> str:
    """SHA-256 of what leads to a diagnosis: its source, Python and the libraries."""
    parts = [source_hash(), platform.python_version(), *(f"{name} {_version(name)}" for name in LIBRARIES)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
