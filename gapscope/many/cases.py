"""Cases of a fleet: their list, addresses on disk or elsewhere, and their files brought here."""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec
from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem
from fsspec.utils import get_protocol

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.case_file import read_case_file, with_files

# Cases at an address: a folder or an archive, on this machine or in the storage of a network.


CASE_FILE = "case.yaml"
STAMPS = (
    ("ETag", "etag", "content_md5", "md5Hash", "CRC", "crc32c"),
    ("mtime", "LastModified", "last_modified", "updated", "created", "date_time"),
)
"""What storages say of a file's content, and of its last change; the first that is there is taken."""
GLOB = "*?["
PROCESS_ONLY = ("memory",)
"""Storages that other processes do not see."""


@dataclass(frozen=True)
class CaseAddress:
    """Where a case is, and what is known of it before it is read.

    Attributes:
        address: of its folder: an absolute path, or a URL as fsspec takes it.
        unit: name of the arm, if a list gives it.
        date: ``YYYY-MM-DD``, if a list gives it.
        fingerprint: hash of names, sizes and stamps of its files; empty if they have not been listed, or have no stamp.
        changed: last change of its files [s since 1970]; ``None`` if not known.
    """

    address: str
    unit: str = ""
    date: str = ""
    fingerprint: str = ""
    changed: float | None = None


Files = Mapping[str, Mapping[str, Any]]
"""What a storage says of each file of a case, by its path below the folder of the case."""


def stamps(files: Files) -> tuple[str, float | None]:
    """Hash of names, sizes and stamps, empty if a file has no stamp; last change of any of them [s since 1970]."""
    digest, unknown = hashlib.sha256(), False
    times = []
    for name, info in sorted(files.items()):
        changed = _first(info, STAMPS[1])
        # a stamp of the content first: a copy of the same file has another time
        stamp = _first(info, STAMPS[0]) or changed
        # without a stamp a change would go unnoticed
        unknown |= stamp is None
        digest.update(f"{name}\0{info.get('size')}\0{stamp}\0".encode())
        if hasattr(changed, "timestamp"):
            changed = changed.timestamp()
        if isinstance(changed, (int, float)):
            times.append(float(changed))
    return "" if unknown else digest.hexdigest(), max(times, default=None)


def open_address(address: str) -> tuple[Any, str]:
    """File system and path of an address.

    Raises:
        InputError: there is no such kind of address.
        GapscopeError: a package for it is missing.
    """
    try:
        return url_to_fs(address)
    except ImportError as error:
        raise GapscopeError(
            f"{address}: cannot be read ({error})",
            "install the package of fsspec for this storage: s3fs, gcsfs, adlfs, ...",
        ) from None
    except (ValueError, OSError) as error:
        raise InputError(
            f"{address}: cannot be opened ({error})",
            "give a folder, a zip archive, a list of cases, or a URL such as s3://bucket/cases",
        ) from None


def is_process_only(address: str) -> bool:
    """Whether other processes cannot read what is at an address."""
    parts = address.split("::")
    return any(get_protocol(part) in PROCESS_ONLY for part in parts)


def find_cases(address: str) -> Iterator[CaseAddress]:
    """Every case at an address, or at any depth below it, in the order of their paths.

    Args:
        address: a folder of a case, its ``case.yaml``, a folder of cases, a zip archive of them, or a pattern (``*``,
            ``**``, ``?``) of any of these; a path, or a URL of fsspec.

    Raises:
        InputError: the address cannot be read, or there is no case.
    """
    # fsspec does not look into an archive unless it is told to
    if address.endswith(".zip") and "::" not in address:
        address = f"zip://::{address}"
    system, path = open_address(address)
    try:
        roots = sorted(system.glob(path)) if set(path) & set(GLOB) else [path]
        count = 0
        for root in roots:
            for case in _below(system, root, address):
                count += 1
                yield case
    except OSError as error:
        raise InputError(
            f"{address}: cannot be listed ({error})", "check address and rights"
        ) from None
    # known only at the end, as cases are given while they are found
    if not count:
        raise InputError(
            f"{address}: no {CASE_FILE} is there or below",
            "give the folder of a case, a folder of such folders, or a list of them (.txt, .csv)",
        )


def _below(system: Any, root: str, address: str) -> Iterator[CaseAddress]:
    """The cases at or below a path."""
    if PurePosixPath(root).name == CASE_FILE:
        root = _parent(root)
    # an archive that a pattern has found
    if root.endswith(".zip"):
        yield from find_cases(_full(system, root, address))
        return
    # one listing for all: a storage charges and delays each request
    listed = system.find(root, detail=True)
    folders = {
        _parent(path)
        for path in listed
        if PurePosixPath(path).name == CASE_FILE and not _is_hidden(path, root)
    }
    files: dict[str, dict[str, Any]] = {folder: {} for folder in sorted(folders)}
    for path, info in listed.items():
        # a case inside another one keeps its files to itself
        folder = _case_folder(path, folders)
        if folder is not None:
            files[folder][_inside(path, folder)] = info
    del listed  # what has been given is let go of: there may be a million files
    for folder in list(files):
        fingerprint, changed = stamps(files.pop(folder))
        full = _full(system, folder, address)
        yield CaseAddress(full, fingerprint=fingerprint, changed=changed)


def list_case(system: Any, folder: str) -> Files:
    """List the files of one case.

    Raises:
        InputError: there is no case.
    """
    listed = system.find(folder, detail=True)
    files = {_inside(path, folder): info for path, info in listed.items()}
    if CASE_FILE not in files:
        raise InputError(f"{folder}: has no {CASE_FILE}", "give the folder of a case")
    return files


def _case_folder(path: str, folders: set[str]) -> str | None:
    """The nearest folder with a case that holds a path."""
    while path:
        path = _parent(path)
        if path in folders:
            return path
    return None


def _is_hidden(path: str, root: str) -> bool:
    """Whether a folder below the root is hidden, as those of cases that are not written to their end."""
    parts = PurePosixPath(_inside(path, root.rstrip("/"))).parts
    return any(part.startswith(".") for part in parts)


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _inside(path: str, folder: str) -> str:
    return path[len(folder) :].removeprefix("/")


def _full(system: Any, path: str, address: str) -> str:
    """The address of a path in a file system that an address has opened."""
    if isinstance(system, LocalFileSystem):
        return path
    # in a chain the first part is a path within what follows
    _, *archive = address.split("::")
    protocol, _ = fsspec.core.split_protocol(address.split("::")[0])
    return "::".join([f"{protocol}://{path.lstrip('/')}", *archive])


def _first(info: Mapping[str, Any], keys: Sequence[str]) -> Any:
    return next((info[key] for key in keys if info.get(key) is not None), None)


# Lists of cases: a text file with an address a line, or a table that also names unit and date.


ENDINGS = (".txt", ".csv")
COLUMNS = ("case", "unit", "date")


def all_cases(addresses: tuple[str, ...]) -> Iterator[CaseAddress]:
    """The cases at several addresses, each of which may be a list."""
    for address in addresses:
        found = read_list if address.endswith(ENDINGS) else find_cases
        yield from found(address)


def read_list(address: str) -> Iterator[CaseAddress]:
    """The cases of a list, each of which is the folder of one case.

    A ``.txt`` file has an address a line; what begins with ``#`` is left out. A ``.csv`` file has the columns ``case``
    and, if wanted, ``unit`` and ``date`` (``YYYY-MM-DD``). Relative paths start from the folder of the list.

    Raises:
        InputError: the list cannot be read; names the line.
    """
    try:
        with fsspec.open(address, "rt", encoding="utf-8", newline="") as file:
            rows = _table(file, address) if address.endswith(".csv") else _lines(file)
            for number, row in rows:
                where = f"line {number}"
                day = row.get("date", "")
                try:
                    # only tested here: the text is what is kept
                    day and date.fromisoformat(day)
                except ValueError:
                    raise InputError(
                        f"{day!r} is no date",
                        "write YYYY-MM-DD",
                        file=address,
                        where=where,
                    ) from None
                if not row["case"]:
                    raise InputError(
                        "names no case", "give its address", file=address, where=where
                    )
                # the case file may be named in place of its folder
                place = _absolute(row["case"], address).removesuffix(f"/{CASE_FILE}")
                yield CaseAddress(place.rstrip("/"), row.get("unit", ""), day)
    except (OSError, ValueError, ImportError) as error:
        raise InputError(
            f"{address}: cannot be read ({error})", "give a list of cases"
        ) from None


def _lines(file: Any) -> Iterator[tuple[int, dict[str, str]]]:
    for number, line in enumerate(file, start=1):
        text = line.strip()
        if text and not text.startswith("#"):
            yield number, {"case": text}


def _table(file: Any, address: str) -> Iterator[tuple[int, dict[str, str]]]:
    reader = csv.DictReader(file)
    header = tuple(reader.fieldnames or ())
    if "case" not in header or not set(header) <= set(COLUMNS):
        raise InputError(
            f"has the columns {', '.join(header) or 'none'}",
            f"expected are case, and if wanted unit and date, out of {', '.join(COLUMNS)}",
            file=address,
            where="line 1",
        )
    for row in reader:
        texts = {key: (value or "").strip() for key, value in row.items()}
        # a quoted field may run over several lines
        yield reader.line_num, texts


def _absolute(text: str, address: str) -> str:
    """An address as it is, or a path that starts from the folder of the list."""
    if "://" in text or text.startswith("/"):
        return text
    if "://" in address:
        return f"{address.rpartition('/')[0]}/{text}"
    return str((Path(address).resolve().parent / text).as_posix())


# A case fetched from its storage into a folder of this machine, within bounds.


CHUNK = 1 << 20
"""Bytes that are copied at a time."""
MAX_FILES = 10_000
"""Files of a case, at most [1]."""


def fetch(system: Any, folder: str, files: Files, to: Path, most: int) -> int:
    """Copy the files of a case; returns their size [bytes].

    Args:
        system: file system of fsspec.
        folder: of the case in it.
        files: of the case.
        to: an empty folder.
        most: bytes that it may have.

    Raises:
        InputError: the case is too large, a file would leave the folder or is a link, or the case file names a file
            outside of its folder.
    """
    _check_files(folder, files, most)
    left = most
    for name in files:
        target = to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        source = f"{folder}/{name}" if folder else name
        # copy a file; what a storage says of its size need not be true
        size = 0
        # exclusive: two names that are one on this disk are refused
        with system.open(source, "rb") as content, target.open("xb") as file:
            while block := content.read(CHUNK):
                size += len(block)
                if size > left:
                    raise _too_large(source, "more than its storage says", left)
                file.write(block)
        left -= size
    with_files(read_case_file(to / CASE_FILE), _check_name)
    return most - left


def _check_files(folder: str, files: Files, most: int) -> None:
    """Refuse what need not be fetched to know that it is not wanted."""
    for name, info in files.items():
        if leaves_folder(name):
            raise InputError(
                f"{folder}: the name {name!r} leaves the case", "rename it"
            )
        if info.get("islink") or info.get("type") != "file":
            raise InputError(
                f"{folder}: {name} is a link or no file", "put the file itself there"
            )
    # before anything is fetched; a missing size shows while it is
    size = sum(int(info.get("size") or 0) for info in files.values())
    if size > most or len(files) > MAX_FILES:
        raise _too_large(folder, f"{len(files)} files of {size} bytes", most)


def _too_large(what: str, has: str, most: int) -> InputError:
    return InputError(
        f"{what}: has {has}, more than {MAX_FILES} files or {most} bytes",
        "split the recording, or allow more with --largest",
    )


def _check_name(field: str, name: str) -> str:
    """Refuse a case that reads other files than its own: what is fetched comes from others."""
    # a variable could name any place on this machine
    if leaves_folder(name) or "${" in name:
        raise InputError(
            f"names {name}, which is outside of the case",
            "put robot and recordings into the folder of the case; a known robot is given by its name",
            file=CASE_FILE,
            where=f"field {field}",
        )
    return name


def leaves_folder(name: str) -> bool:
    """Whether a relative path could lead out of its folder, on any system."""
    # on Windows a backslash parts names, and a letter names a drive
    parts = PurePosixPath(name.replace("\\", "/")).parts
    drive = re.match(r"[A-Za-z]:", name)
    return not parts or ".." in parts or parts[0] == "/" or "\0" in name or bool(drive)
