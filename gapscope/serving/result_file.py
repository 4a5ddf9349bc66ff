"""From an address to a file of results, and to none other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote_to_bytes

TYPES = {
    "report.html": "text/html; charset=utf-8",
    "diagnosis.json": "application/json",
    "corrected.yaml": "application/yaml",
}
"""The files that are served, by name, with their types."""
_FORBIDDEN = ("/", "\\", ":", "\0")
"""Not part of one name on some system."""


def plain_text(quoted: str) -> str:
    """A part of an address, decoded once, as a name on disk."""
    return os.fsdecode(unquote_to_bytes(quoted))


def file_names(path: str) -> list[str] | None:
    """Names of folders and file in the path of an address; ``None`` if one is no plain name, or hidden.

    It is split before it is decoded, so that an encoded slash or dot stays in its part.
    """
    names = [plain_text(part) for part in path.split("/")]
    for name in names:
        # a first dot is that of "." and ".." too
        if not name or name.startswith(".") or any(c in name for c in _FORBIDDEN):
            return None
    return names


def result_file(root: Path, names: Sequence[str]) -> Path | None:
    """The file of results at a place below a folder.

    Args:
        root: the folder, resolved.
        names: of the folders below it, and of the file at the end.

    Returns:
        The file, links resolved; ``None`` if its name is not that of a result, it is no file, or it lies outside.
    """
    if names[-1] not in TYPES:
        return None
    try:
        path = root.joinpath(*names).resolve(strict=True)
    except (OSError, RuntimeError, ValueError):  # missing, a loop, or too long a name
        return None
    return path if path.is_relative_to(root) and path.is_file() else None
