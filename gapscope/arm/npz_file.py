"""Arrays of an NPZ file: read without pickle, of bounded size, with one answer to whatever is wrong with it."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_IN_MEMORY, LARGEST_UNPACKED, check_file

_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    OSError,
    OverflowError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,
    MemoryError,
)
"""What numpy and zipfile raise on archives that are damaged, encrypted, or hold objects."""


def read_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file by name.

    Args:
        path: the file.
        remedy: what to do if it cannot be used.

    Raises:
        InputError: there is no such file, it is too large, packed or unpacked, or no complete NPZ file.
    """
    check_file(path, remedy, LARGEST_IN_MEMORY)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size <= LARGEST_UNPACKED:
            with np.load(path, allow_pickle=False) as content:
                return {name: np.asarray(content[name]) for name in content.files}
    except _DAMAGED as error:
        said = str(error) or type(error).__name__
        raise InputError(f"cannot be read as NPZ ({said})", remedy, file=path) from None
    raise InputError(
        f"holds {size / 1e9:.1f} GB unpacked, at most {LARGEST_UNPACKED / 1e9:g} GB are read",
        "cut the motion to be examined out of it",
        file=path,
    )
