"""The one check on what a path leads to: a regular file of bounded size, or a folder of those.

A path may be impossible: too long for a file system, with a null byte, a loop of links. Or it leads to what is no file:
a FIFO, which nobody may ever write to, a device that never ends, a socket. Links to regular files are followed.
"""

from __future__ import annotations

import hashlib
import os
import stat
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import DEFAULT_BUFFER_SIZE
from pathlib import Path

import numpy as np
from scipy.constants import giga, mega

from gapscope.arm.errors import InputError

LARGEST_DOCUMENT = 50 * mega
"""Size of the largest YAML, JSON, URDF or MJCF file that is read [bytes]; those of any arm have less than a tenth."""
LARGEST_IN_MEMORY = 2 * giga
"""Size of the largest file that is read whole into memory, as NPZ and MATLAB files are [bytes]."""
LARGEST_NUMBER = float(np.sqrt(np.sqrt(np.finfo(float).max)))
"""Size of the largest number in a file, whatever it counts; products of four larger ones overflow [1]."""
LARGEST_UNPACKED = LARGEST_IN_MEMORY
"""Size of the largest compressed content once unpacked [bytes]."""

_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}
_BESIDE = "give a path below this folder, without a link that leaves it"


def is_folder(path: Path) -> bool:
    """Whether there is a folder; false for a path that no file system can have."""
    found = _status(path)
    return isinstance(found, os.stat_result) and stat.S_ISDIR(found.st_mode)


def is_file(path: Path) -> bool:
    """Whether there is a regular file; false for a path that no file system can have."""
    found = _status(path)
    return isinstance(found, os.stat_result) and stat.S_ISREG(found.st_mode)


def real_path(path: Path) -> Path:
    """The absolute path with links followed; of a loop of links as far as that goes."""
    return Path(os.path.realpath(path))


def check_file(
    path: Path,
    remedy: str,
    largest: int | None = None,
    absent: str = "no such file or folder",
) -> None:
    """Check that a path leads to a regular file.

    Args:
        path: as the user gave it.
        remedy: what to do if there is no such file.
        largest: number of bytes that it may have; any by default, for what is read piece by piece.
        absent: what to say if there is no such file.

    Raises:
        InputError: there is no such file, it is something else, or it is too large.
    """
    found = _status(path)
    if not isinstance(found, os.stat_result):
        why = f" ({found})" if found else ""
        raise InputError(f"{absent}{why}", remedy, file=path)
    # what could never be read to its end: pipes, devices, sockets
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        name = _KINDS.get(kind, "no regular file")
        raise InputError(
            f"is {name}, expected a file",
            "give a regular file; copy what comes through a FIFO or device into one",
            file=path,
        )
    if largest is not None and found.st_size > largest:
        raise InputError(
            f"has {found.st_size / 1e9:.3g} GB, at most {largest / 1e9:g} GB are read",
            "cut out of it what is needed; a bag or HDF5 file may be larger",
            file=path,
        )


def check_folder_files(files: Iterable[Path]) -> None:
    """Check that the files of a folder, such as a bag, are regular ones; raises ``InputError``."""
    for file in files:
        check_file(file, "is the folder complete?")


def read_bytes(
    path: Path, remedy: str, largest: int | None = LARGEST_DOCUMENT
) -> bytes:
    """Content of a file, of any size if ``largest`` is ``None``.

    Raises:
        InputError: as ``check_file``; or it may not be read.
    """
    check_file(path, remedy, largest)
    with _readable(path, remedy):
        return path.read_bytes()


@contextmanager
def _readable(path: Path, remedy: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", remedy, file=path
        ) from None


def digest_of(path: Path, remedy: str) -> bytes:
    """SHA-256 of a file of any size, read piece by piece.

    Raises:
        InputError: as ``read_bytes``.
    """
    check_file(path, remedy)
    digest = hashlib.sha256()
    with _readable(path, remedy), path.open("rb") as file:
        # a dataset of any size is hashed with the memory of one piece
        while piece := file.read(DEFAULT_BUFFER_SIZE):
            digest.update(piece)
    return digest.digest()


def read_text(path: Path, remedy: str, largest: int = LARGEST_DOCUMENT) -> str:
    """Content of a text file in UTF-8.

    Raises:
        InputError: as ``read_bytes``; or it is no text.
    """
    try:
        return read_bytes(path, remedy, largest).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("is not a text in UTF-8", remedy, file=path) from None


def file_beside(folder: Path, name: object, source: Path, where: str) -> Path:
    """The file that a document names by a path relative to its own folder.

    A result is passed on as a folder, so that what it names has to lie in there: a document from elsewhere may not make
    a command open other files of the machine.

    Args:
        folder: of the document.
        name: as it stands in the document.
        source: the document, for messages.
        where: the field that holds the name.

    Raises:
        InputError: the name is none, is absolute, or leads out of the folder.
    """
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError("expected the name of a file", file=source, where=where)
    place = folder / name
    # by real paths, so that a link within the folder may not lead out of it
    inside = real_path(place).is_relative_to(real_path(folder))
    if Path(name).is_absolute() or not inside:
        raise InputError(
            f"names {name}, which leads out of its folder",
            _BESIDE,
            file=source,
            where=where,
        )
    return place


def _status(path: Path) -> os.stat_result | str:
    """What is at a path, links followed; or why nothing can be there, empty if nothing is."""
    try:
        # links are followed: what counts is where they lead
        return path.stat()
    except FileNotFoundError:
        return ""
    except OSError as error:
        return error.strerror or "it cannot be reached"
    except ValueError:
        return "a name with a null byte"


# Files that a library reads: of bounded size once unpacked, with one answer to whatever is wrong with them.


@contextmanager
def complete_file(
    path: Path, form: str, remedy: str = "is the file complete?"
) -> Iterator[None]:
    """Whatever a library raises on a file of a form, which is damaged then, as the one error on it.

    Raises:
        InputError: the block raised anything.
    """
    try:
        yield
    except InputError:
        raise
    # libraries stumble over damaged files in as many ways as they have lines
    except Exception as error:
        # of what goes on over many lines the first says it
        said = str(error).split("\n")[0] or type(error).__name__
        raise InputError(
            f"cannot be read as {form} ({said})", remedy, file=path
        ) from None


def check_unpacked(size: float, path: Path) -> None:
    """Check that a file is not beyond ``LARGEST_UNPACKED`` once unpacked: a run of one value takes no place in it.

    Raises:
        InputError: it is.
    """
    if size > LARGEST_UNPACKED:
        raise InputError(
            f"holds {size / 1e9:.1f} GB unpacked, at most {LARGEST_UNPACKED / 1e9:g} GB are read",
            "cut the motion to be examined out of it",
            file=path,
        )


def read_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file by name, without pickles.

    Args:
        path: the file.
        remedy: what to do if it cannot be used.

    Raises:
        InputError: there is no such file, it is too large, packed or unpacked, or no complete NPZ file.
    """
    check_file(path, remedy, LARGEST_IN_MEMORY)
    with complete_file(path, "NPZ", remedy):
        # sizes stand in the directory of the archive: nothing is unpacked for them
        with zipfile.ZipFile(path) as archive:
            check_unpacked(sum(x.file_size for x in archive.infolist()), path)
        # pickles in an array would be run
        with np.load(path, allow_pickle=False) as content:
            return {name: np.asarray(content[name]) for name in content.files}
