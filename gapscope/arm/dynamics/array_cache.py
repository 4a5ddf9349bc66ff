"""Results of recent calls, kept while they fit."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from hashlib import blake2b

import numpy as np

MAX_BYTES = 2**28
"""Results are kept up to this size in all [bytes]."""

Arrays = tuple[np.ndarray, ...]


class ArrayCache:
    """Arrays computed from arrays, kept by the content of their arguments; the ones not used for longest go first.

    Args:
        most_bytes: size up to which results are kept; the last one is kept whatever its size.
    """

    def __init__(self, most_bytes: int = MAX_BYTES) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[bytes, Arrays] = OrderedDict()
        self._bytes = 0

    def get(
        self, name: str, arguments: Arrays, compute: Callable[[], Arrays]
    ) -> Arrays:
        """Result of ``compute``, computed or remembered; its arrays cannot be written to.

        Args:
            name: of what is computed.
            arguments: everything that the result depends on.
            compute: computes it.
        """
        digest = blake2b(name.encode())
        for argument in arguments:
            # the same numbers in another shape are another argument
            digest.update(repr(np.shape(argument)).encode())
            digest.update(np.ascontiguousarray(argument).data)
        key = digest.digest()
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        result = compute()
        for array in result:
            array.flags.writeable = False
        self._kept[key] = result
        self._bytes += sum(array.nbytes for array in result)
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            self._bytes -= sum(array.nbytes for array in oldest)
        return result
