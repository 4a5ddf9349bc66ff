"""Values of joints side by side: those of one arm, or of several arms one after the other."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import ClassVar, Generic, TypeVar

import numpy as np

from gapscope.effects.catalogue import CATALOGUE
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
            repeated = (
                own.beside(count) if isinstance(own, Rows) else np.tile(own, count)
            )
            setattr(many, name, repeated)
        return many

    def put(self: R, number: int, one: R) -> None:
        """Take over the values of one arm as those of arm ``number``, counted from 0."""
        for name in self.ROWS:
            own, new = getattr(self, name), getattr(one, name)
            if isinstance(own, Rows):
                own.put(number, new)
            else:
                own[number * len(new) : (number + 1) * len(new)] = new


class Laws(Rows, Generic[K]):
    """Effects of one kind on joints, each with the values of its parameters, (k,), 0 on joints without it.

    An effect is on at a joint if a parameter that goes with its severity is not zero there.

    Args:
        found: effects with their parameters over all joints of an arm, as ``CorrectedArm.of_kind`` gives them.
        order: the arm's joints in the order of the rows.

    Attributes:
        acting: the effects that are on at some joint, in the order in which they act, with their values.
        joints: mask of the joints at which one is on, shape (k,).
    """

    def __init__(
        self, found: Iterable[tuple[K, list[np.ndarray]]], order: np.ndarray
    ) -> None:
        self._size = len(order)
        self._known: dict[str, tuple[K, list[np.ndarray]]] = {}
        for effect, values in found:
            # one effect may be given several times, each on other joints
            _, rows = self._known.get(effect.name) or (effect, [0.0] * len(values))
            together = [
                row + value[order] for row, value in zip(rows, values, strict=True)
            ]
            self._known[effect.name] = effect, together
        self._note()

    def _note(self) -> None:
        """Note which effects are on, and where; the order of the catalogue makes sums the same on every arm."""
        self.joints: np.ndarray = np.zeros(self._size, dtype=bool)
        places = {name: place for place, name in enumerate(CATALOGUE)}
        acting = []
        for name, (effect, rows) in self._known.items():
            pairs = zip(effect.parameters, rows, strict=True)
            telling = [row for parameter, row in pairs if parameter.severity] or rows
            on = np.any(telling, axis=0)
            if on.any():
                self.joints |= on
                order = getattr(effect, "place", 0), places.get(name, len(places))
                acting.append((order, effect, rows))
        acting.sort(key=lambda item: item[0])
        self.acting = [(effect, rows) for _, effect, rows in acting]
        self._known = {effect.name: (effect, rows) for effect, rows in self.acting}

    def beside(self, count: int) -> Laws[K]:
        """The same for ``count`` such arms."""
        many = copy(self)
        many._size = count * self._size
        many._known = {
            name: (effect, [np.tile(row, count) for row in rows])
            for name, (effect, rows) in self._known.items()
        }
        many._note()
        return many

    def put(self, number: int, one: Laws[K]) -> None:
        """Take over the effects of one arm as those of arm ``number``; arms may have different ones."""
        part = slice(number * one._size, (number + 1) * one._size)
        for _, rows in self._known.values():
            for row in rows:
                row[part] = 0.0
        for name, (effect, values) in one._known.items():
            nothing = effect, [np.zeros(self._size) for _ in values]
            _, rows = self._known.setdefault(name, nothing)
            for row, value in zip(rows, values, strict=True):
                row[part] = value
        self._note()
