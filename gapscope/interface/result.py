"""What every function of the interface returns: a record with files, a text and a table."""

from __future__ import annotations

import html
import io
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

import pandas as pd
from rich.console import Console

SCREEN = 24
"""Lines of a screen."""


class Result(ABC):
    """A result that can be saved as files, read as text, and looked at as a data frame."""

    @abstractmethod
    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the result's files into a folder, each whole or not at all.

        Returns:
            The files, the one to open first.

        Raises:
            GapscopeError: the folder cannot be written to.
        """

    @abstractmethod
    def summary(self) -> str:
        """The result as text of at most 80 columns."""

    @abstractmethod
    def to_frame(self) -> pd.DataFrame:
        """The figures of the result as a data frame."""

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        """The first screen of the text."""
        lines = self.summary().splitlines()
        if len(lines) <= SCREEN:
            return "\n".join(lines)
        more = f"... {len(lines) - SCREEN + 1} more lines: print(result)"
        return "\n".join([*lines[: SCREEN - 1], more])

    def _repr_html_(self) -> str:
        """What a notebook shows: the first screen of the text, and the data frame below it."""
        table = self.to_frame().to_html(max_rows=12, float_format="{:.4g}".format)
        return f"<pre>{html.escape(repr(self))}</pre>{table}"


def as_text(show: Callable[[Console], None]) -> str:
    """What a function prints on a terminal of 80 columns, without colours."""
    text = io.StringIO()
    show(Console(file=text, width=80, color_system=None))
    return text.getvalue().rstrip()
