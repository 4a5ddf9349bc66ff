"""Values of joints side by side: those of one arm, or of several arms one after the other."""

from __future__ import annotations

from copy import copy
from typing import ClassVar, TypeVar

import numpy as np

R = TypeVar("R", bound="Rows")
"""A class of values of joints."""


class Rows:
    """A calculation that is done joint by joint, so that joints of several arms can stand in one array.

    Attributes:
        ROWS: names of the attributes that hold one value per joint, shape (k,).
    """

    ROWS: ClassVar[tuple[str, ...]] = ()

    def beside(self: R, count: int) -> R:
        """The same for ``count`` such arms, joints of the first arm first."""
        many = copy(self)
        for name in self.ROWS:
            setattr(many, name, np.tile(getattr(self, name), count))
        return many

    def put(self: R, number: int, one: R) -> None:
        """Take over the values of one arm as those of arm ``number``, counted from 0."""
        size = len(getattr(one, self.ROWS[0]))
        part = slice(number * size, (number + 1) * size)
        for name in self.ROWS:
            getattr(self, name)[part] = getattr(one, name)
