"""A case fetched from its storage into a folder of this machine, within bounds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_case_file
from gapscope.fleets.addresses import CASE_FILE, CaseListing

CHUNK = 1 << 20
"""Bytes that are copied at a time."""
MOST_FILES = 10_000
"""Files of a case, at most [1]."""


def fetch(system: Any, folder: str, listing: CaseListing, to: Path, most: int) -> int:
    """Copy the files of a case; returns their size [bytes].

    Args:
        system: file system of fsspec.
        folder: of the case in it.
        listing: its files.
        to: an empty folder.
        most: bytes that it may have.

    Raises:
        InputError: the case is too large, a file would leave the folder or is a link, or the case file names a file
            outside of its folder.
    """
    _check_files(folder, listing, most)
    left = most
    for name in listing.files:
        target = to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        source = f"{folder}/{name}" if folder else name
        left -= _copy(system, source, target, left)
    _check_case_file(to / CASE_FILE)
    return most - left


def _check_files(folder: str, listing: CaseListing, most: int) -> None:
    """Refuse what need not be fetched to know that it is not wanted."""
    for name, info in listing.files.items():
        if leaves_folder(name):
            raise InputError(
                f"{folder}: the name {name!r} leaves the case", "rename it"
            )
        if info.get("islink") or info.get("type") != "file":
            raise InputError(
                f"{folder}: {name} is a link or no file", "put the file itself there"
            )
    size = sum(int(info.get("size") or 0) for info in listing.files.values())
    if size > most or len(listing.files) > MOST_FILES:
        raise _too_large(folder, f"{len(listing.files)} files of {size} bytes", most)


def _copy(system: Any, source: str, target: Path, most: int) -> int:
    """Copy a file; what a storage says of its size need not be true."""
    size = 0
    with system.open(source, "rb") as content, target.open("xb") as file:
        while block := content.read(CHUNK):
            size += len(block)
            if size > most:
                raise _too_large(source, "more than its storage says", most)
            file.write(block)
    return size


def _too_large(what: str, has: str, most: int) -> InputError:
    return InputError(
        f"{what}: has {has}, more than {MOST_FILES} files or {most} bytes",
        "split the recording, or allow more with --largest",
    )


def _check_case_file(file: Path) -> None:
    """Refuse a case that reads other files than its own: what is fetched comes from others."""
    content = read_case_file(file)
    for field, text in _named_files(content):
        if leaves_folder(text) or "${" in text:
            raise InputError(
                f"names {text}, which is outside of the case",
                "put robot and recordings into the folder of the case; a known robot is given by its name",
                file=CASE_FILE,
                where=f"field {field}",
            )


def _named_files(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Fields of a case file that name files, and the names."""
    yield "robot", str(content["robot"])
    for field in ("recordings", "judge"):
        for entry in content.get(field, []):
            names = entry.values() if isinstance(entry, Mapping) else [entry]
            yield from ((field, str(name)) for name in names)
    yield from (("payloads", str(name)) for name in content.get("payloads") or {})
    section = content.get("import") or {}
    if "calibration" in section:
        yield "import.calibration", str(section["calibration"])


def leaves_folder(name: str) -> bool:
    """Whether a relative path could lead out of its folder, on any system."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    drive = re.match(r"[A-Za-z]:", name)
    return not parts or ".." in parts or parts[0] == "/" or "\0" in name or bool(drive)
