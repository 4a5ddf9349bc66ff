"""What every function of the interface returns: a record with files, a text and a table."""

from __future__ import annotations

import html
import io
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from rich.console import Console, RenderableType

from gapscope.arm.io.atomic_write import make_folder
from gapscope.arm.io.write_case import write_columns

if TYPE_CHECKING:
    import pandas as pd

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
    def shown(self) -> RenderableType:
        """What a terminal shows of the result: text, or tables of rich."""

    def summary(self) -> str:
        """The result as text of at most 80 columns."""
        shown = self.shown()
        if isinstance(shown, str):
            return shown
        text = io.StringIO()
        Console(file=text, width=80, color_system=None).print(shown)
        return text.getvalue().rstrip()

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


class TableResult(Result):
    """A result whose data frame is its file, under the name ``FILE``."""

    FILE: ClassVar[str]

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the columns of the data frame as CSV."""
        make_folder(Path(folder))
        file = Path(folder) / self.FILE
        self.write(file)
        return (file,)

    def write(self, file: Path) -> None:
        """Write one CSV, Parquet or NPZ file; raises ``GapscopeError`` if it cannot be written."""
        write_columns({name: x.to_numpy() for name, x in self.to_frame().items()}, file)
