"""Values of joints side by side, those of one arm or of several arms one after the other, and laws that act on them.

What laws that are called in every step do with their arguments is noted once, and then repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from gapscope.effects.effect import Effect

R = TypeVar("R", bound="Rows")
"""A class of values of joints."""
K = TypeVar("K", bound=Effect)
"""A kind of effects."""


class Rows:
    """A calculation that is done joint by joint, so that joints of several arms can stand in one array.

    Attributes:
        ROWS: names of the attributes that hold one value per joint, shape (k,), or are such calculations themselves.
    """

    ROWS: ClassVar[tuple[str, ...]] = ()

    def beside(self: R, count: int) -> R:
        """The same for ``count`` such arms, joints of the first arm first."""
        many = copy(self)
        for name in self.ROWS:
            own = getattr(self, name)
            several = (
                own.beside(count) if isinstance(own, Rows) else np.tile(own, count)
            )
            setattr(many, name, several)
        many.note()
        return many

    def put(self: R, number: int, one: R) -> None:
        """Take over the values of one arm as those of arm ``number``, counted from 0."""
        for name in self.ROWS:
            own, new = getattr(self, name), getattr(one, name)
            if isinstance(own, Rows):
                own.put(number, new)
            else:
                own[number * len(new) : (number + 1) * len(new)] = new
        self.note()

    def note(self) -> None:
        """Note what follows from the values, whenever they have changed."""


class Laws(Rows, Generic[K]):
    """Effects of one kind on joints, each with the values of its parameters, 0 on joints without it.

    An effect is on at a joint if a parameter that goes with its severity is not zero there.

    Args:
        found: effects with their parameters over all joints of an arm, as ``CorrectedArm.of_kind`` gives them.
        order: the arm's joints in the order of the rows.

    Attributes:
        acting: the effects that are on at some joint, with one row of values per parameter, in the order of their
            place and name, so that sums are the same on every arm.
        joints: mask of the joints at which one is on, shape (k,).
    """

    def __init__(
        self, found: Iterable[tuple[K, list[np.ndarray]]], order: np.ndarray
    ) -> None:
        self._known: dict[str, tuple[K, np.ndarray]] = {}
        self.joints: np.ndarray = np.zeros(len(order), dtype=bool)
        for effect, values in found:
            # one effect may be given several times, each on other joints
            rows = np.array(values)[:, order]
            if effect.name in self._known:
                rows += self._known[effect.name][1]
            self._known[effect.name] = effect, rows
        self.note()

    def note(self) -> None:
        """Note which effects are on, and where; those that are on nowhere are forgotten."""
        self.acting = []
        self.joints = np.zeros_like(self.joints)
        for effect, rows in self._known.values():
            telling = [parameter.severity != 0 for parameter in effect.parameters]
            on = rows[telling].any(axis=0)
            if on.any():
                self.acting.append((effect, rows))
                self.joints |= on
        self.acting.sort(key=lambda item: (getattr(item[0], "place", 0), item[0].name))
        self._known = {item[0].name: item for item in self.acting}

    def beside(self, count: int) -> Laws[K]:
        """The same for ``count`` such arms."""
        many = copy(self)
        many.joints = np.tile(self.joints, count)
        many._known = {
            effect.name: (effect, np.tile(rows, count)) for effect, rows in self.acting
        }
        many.note()
        return many

    def put(self, number: int, one: Laws[K]) -> None:
        """Take over the effects of one arm as those of arm ``number``; arms may have different ones."""
        part = slice(number * len(one.joints), (number + 1) * len(one.joints))
        for _, rows in self.acting:
            rows[:, part] = 0.0
        for effect, values in one.acting:
            nothing = np.zeros((len(values), len(self.joints)))
            self._known.setdefault(effect.name, (effect, nothing))[1][:, part] = values
        self.note()


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
    if not isinstance(result, _Noted) or not notes.end(result.value):
        return function
    return notes


class _Notes:
    """The operations of a function, in their order, and where its arguments go in."""

    def __init__(self) -> None:
        self._calls: list[tuple[np.ufunc, list[Any]]] = []
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
        self._calls.append((operation, call))
        return _Noted(self, out)

    def end(self, result: np.ndarray) -> bool:
        """Whether the function ends with the last operation; its result takes memory of its own each time."""
        if not self._calls or self._calls[-1][1][-1] is not result:
            return False
        self._last, self._inputs = self._calls.pop()
        self._inputs.pop()
        return True

    def __call__(self, *arguments: np.ndarray | float) -> np.ndarray:
        """The function's value, an array of its own."""
        for inputs, place, number in self._given:
            inputs[place] = arguments[number]
        for operation, inputs in self._calls:
            operation(*inputs)
        value: np.ndarray = self._last(*self._inputs)
        return value


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
