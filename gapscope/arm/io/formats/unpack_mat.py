"""Numeric arrays of MATLAB files into NPZ files; a script of its own, without the package.

SciPy's reader trusts the tags of a file, and a damaged one can end its process or take any memory: it runs in a process
that may end, and with bounded memory.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np


def arrays_of(content: Any, name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of nested structures by their names; those of a list are counted from 1."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            if not str(key).startswith("__"):
                yield from arrays_of(value, f"{name}.{key}" if name else str(key))
    elif isinstance(content, list):
        for number, value in enumerate(content, start=1):
            yield from arrays_of(value, f"{name}.{number}")
    elif isinstance(content, np.ndarray) and content.dtype.kind in "fiub":
        yield name, content


def unpack(path: str, out: str, largest: float) -> list[str] | str:
    """Write the arrays of a MATLAB file up to version 7.2; their names in order, or what is wrong with it.

    Those of more than ``largest`` [bytes] in all are not read.
    """
    import scipy.io

    try:
        # sizes as the file states them, before anything is unpacked
        size = 8 * sum(math.prod(shape) for _, shape, _ in scipy.io.whosmat(path))
        if size > largest:
            return f"it holds {size:.2g} bytes unpacked, at most {largest:g} are read"
        found = dict(arrays_of(scipy.io.loadmat(path, simplify_cells=True), ""))
        np.savez(out, *found.values())
    # the reader stumbles over damaged files in as many ways as it has lines
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return list(found)


def main(largest: str) -> None:
    """Answer each line with the arguments of ``unpack``, until there are no more.

    Args:
        largest: memory that the process may take [bytes], where the system bounds it.
    """
    # bounded where the system can: a tag that asks for all memory then fails alone
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(largest), int(largest)))
    for line in sys.stdin:
        print(json.dumps(unpack(*json.loads(line))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
