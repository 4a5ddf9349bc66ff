"""Laws that are called in every step: what they do with their arguments is noted once, and then repeated."""

from __future__ import annotations

from collections.abc import Callable
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
    arguments = [_Noted(notes, np.zeros(size), number) for number in range(count)]
    try:
        with np.errstate(all="ignore"):
            result: Any = function(*arguments)
    except (AttributeError, TypeError, ValueError):
        return function
    last = notes.calls[-1][1][-1] if notes.calls else None
    if not isinstance(result, _Noted) or result.value is not last:
        return function
    return notes


class _Notes:
    """The operations of a function, in their order, and where its arguments go in."""

    def __init__(self) -> None:
        self.calls: list[tuple[np.ufunc, list[Any]]] = []
        self._given: list[tuple[list[Any], int, int]] = []

    def note(self, operation: np.ufunc, *inputs: Any) -> _Noted:
        """Note an operation, of which at least one input goes back to an argument."""
        call = [x.value if isinstance(x, _Noted) else np.asarray(x) for x in inputs]
        for place, x in enumerate(inputs):
            if isinstance(x, _Noted) and x.number is not None:
                self._given.append((call, place, x.number))
        out = operation(*call)
        # where the result goes to comes last
        call.append(out)
        self.calls.append((operation, call))
        return _Noted(self, out)

    def __call__(self, *arguments: np.ndarray | float) -> np.ndarray:
        """The function's value, an array of its own."""
        for inputs, place, number in self._given:
            inputs[place] = arguments[number]
        for operation, inputs in self.calls:
            operation(*inputs)
        return np.array(self.calls[-1][1][-1])


class _Noted(NDArrayOperatorsMixin):
    """An array that stands for argument ``number``, or comes from one; nobody may ask for its values."""

    __array__ = __bool__ = None

    def __init__(
        self, notes: _Notes, value: np.ndarray, number: int | None = None
    ) -> None:
        self._notes, self.value, self.number = notes, value, number

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any
    ) -> Any:
        """Have the operation noted, if it is a plain one."""
        if method != "__call__" or kwargs or ufunc.nout != 1:
            return NotImplemented
        return self._notes.note(ufunc, *inputs)
