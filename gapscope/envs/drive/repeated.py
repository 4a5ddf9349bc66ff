"""Laws that are called in every step: what they do with their arguments is noted once, and then repeated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


class Repeated:
    """A function of arrays of one shape, called once to note what NumPy does with them, then repeated on others.

    What depends on its constants alone is computed once, and memory is taken once: for the few joints of an arm that is
    half of the time. A function that does anything but apply ufuncs to its arguments, as to ask whether one is
    positive, cannot be noted and is called each time.

    Args:
        function: of ``count`` arrays; what it takes from elsewhere may not change.
        count: number of arguments.
        size: of each array.
    """

    def __init__(
        self, function: Callable[..., np.ndarray], count: int, size: int
    ) -> None:
        self._function = function
        self._calls: list[tuple[np.ufunc, list[Any]]] = []
        self._given: list[tuple[list[Any], int, int]] = []
        arguments = [_Noted(self, np.zeros(size), number) for number in range(count)]
        try:
            with np.errstate(all="ignore"):
                result: Any = function(*arguments)
        except (AttributeError, TypeError, ValueError):
            result = None
        noted = isinstance(result, _Noted) and result.number is None
        self._result = result.value if noted else None

    def __call__(self, *arguments: np.ndarray | None) -> np.ndarray:
        """Its value; the array is filled anew by the next call."""
        if self._result is None:
            return self._function(*arguments)
        for inputs, place, number in self._given:
            inputs[place] = arguments[number]
        for operation, inputs in self._calls:
            operation(*inputs)
        return self._result

    def note(self, operation: np.ufunc, *inputs: Any) -> _Noted:
        """Note an operation, of which at least one input goes back to an argument."""
        call = [x.value if isinstance(x, _Noted) else np.asarray(x) for x in inputs]
        for place, x in enumerate(inputs):
            if isinstance(x, _Noted) and x.number is not None:
                self._given.append((call, place, x.number))
        out = operation(*call)
        call.append(out)
        self._calls.append((operation, call))
        return _Noted(self, out)


class _Noted(NDArrayOperatorsMixin):
    """An array that stands for argument ``number``, or comes from one; nobody may ask for its values."""

    __array__ = __bool__ = None

    def __init__(
        self, function: Repeated, value: np.ndarray, number: int | None = None
    ) -> None:
        self._noting, self.value, self.number = function, value, number

    def __array_ufunc__(
        self, operation: np.ufunc, method: str, *inputs: Any, **options: Any
    ) -> Any:
        """Have the operation noted, if it is a plain one."""
        if method != "__call__" or options or operation.nout != 1:
            return NotImplemented
        return self._noting.note(operation, *inputs)
