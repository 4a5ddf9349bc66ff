"""Laws that are called in every step: what they do with their arguments is noted once, and then repeated."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import CodeType
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


def repeated(
    function: Callable[..., np.ndarray], count: int, size: int
) -> Callable[..., np.ndarray]:
    """A function of arrays of one shape as one that does no more than the ufuncs which it applies to them.

    What depends on its constants alone is computed once, and memory is taken once: for the few joints of an arm that is
    half of the time. A function that does anything else with its arguments, as to ask whether one is positive, is given
    back as it is.

    Args:
        function: of ``count`` arrays; what it takes from elsewhere may not change.
        count: number of arguments.
        size: of each array.
    """
    notes = _Notes()
    arguments = [_Noted(notes, np.zeros(size), f"a{i}") for i in range(count)]
    try:
        with np.errstate(all="ignore"):
            result: Any = function(*arguments)
    except (AttributeError, TypeError, ValueError):
        return function
    if not notes or result is not notes[-1][1]:
        return function
    lines = [f"{call}, {out.name})" for call, out in notes]
    # what comes out is an array of its own, no memory that is used again
    lines[-1] = f"return {notes[-1][0]})"
    names = ", ".join(
        [*(x.name for x in arguments), *(f"{x}={x}" for x in notes.known)]
    )
    body = "\n ".join(lines)
    exec(_code(f"def noted({names}):\n {body}"), notes.known)
    return notes.known["noted"]


@cache
def _code(source: str) -> CodeType:
    """Compiled code; laws of one form share it."""
    return compile(source, "<law>", "exec")


class _Notes(list[tuple[str, "_Noted"]]):
    """Operations as source code without the end of the call, each with what it gives.

    Attributes:
        known: functions and arrays by their names in it.
    """

    def __init__(self) -> None:
        super().__init__()
        self.known: dict[str, Any] = {}

    def name(self, value: Any) -> str:
        """A new name for a value."""
        name = f"x{len(self.known)}"
        self.known[name] = value
        return name


class _Noted(NDArrayOperatorsMixin):
    """An array that is an argument, or comes from one; nobody may ask for its values."""

    __array__ = __bool__ = None

    def __init__(self, notes: _Notes, value: np.ndarray, name: str) -> None:
        self._notes, self.value, self.name = notes, value, name

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any
    ) -> Any:
        """Note the operation, if it is a plain one."""
        if method != "__call__" or kwargs or ufunc.nout != 1:
            return NotImplemented
        notes = self._notes
        out = ufunc(*(x.value if isinstance(x, _Noted) else x for x in inputs))
        names = [x.name if isinstance(x, _Noted) else notes.name(x) for x in inputs]
        given = _Noted(notes, out, notes.name(out))
        notes.append((f"{notes.name(ufunc)}({', '.join(names)}", given))
        return given
