"""What every function of the interface returns: a record with files, a text and a table."""

from __future__ import annotations

import html
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from rich.console import Console, RenderableType

from gapscope.arm.io.atomic_write import begin_results, make_folder
from gapscope.arm.io.json_file import write_json
from gapscope.arm.io.write_case import check_csv, write_columns

if TYPE_CHECKING:
    import pandas as pd

SCREEN = 24
"""Lines of a screen."""
Document = dict[str, Any]
"""Content of a JSON file."""


class Result(ABC):
    """A result that can be saved as files, read as text, and looked at as a data frame."""

    COLUMNS: ClassVar[tuple[str, ...] | None] = None
    """Of the data frame; by default those of its rows."""

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

    def table(self) -> Iterable[Any] | Mapping[str, Any]:
        """The figures of the result, unless it makes its own data frame: rows, or columns by name."""
        raise NotImplementedError

    def to_frame(self) -> pd.DataFrame:
        """The figures of the result as a data frame."""
        # only if asked for: results are used without it
        import pandas as pd

        # a mapping holds columns, all else rows
        table = self.table()
        content = table if isinstance(table, Mapping) else list(table)
        return pd.DataFrame(content, columns=self.COLUMNS)

    def summary(self) -> str:
        """The result as text of at most 80 columns."""
        shown = self.shown()
        # a text is shown as it is, only tables have to be laid out
        if isinstance(shown, str):
            return shown
        text = io.StringIO()
        # the same in a file, a notebook and a pipe: fixed width, no colours
        Console(file=text, width=80, color_system=None).print(shown)
        return text.getvalue().rstrip()

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        """The first screen of the text."""
        lines = self.summary().splitlines()
        # a prompt shows no more than a screen; print shows all
        if len(lines) <= SCREEN:
            return "\n".join(lines)
        more = f"... {len(lines) - SCREEN + 1} more lines: print(result)"
        return "\n".join([*lines[: SCREEN - 1], more])

    def _repr_html_(self) -> str:
        """What a notebook shows: the first screen of the text, and the data frame below it."""
        table = self.to_frame().to_html(max_rows=12, float_format="{:.4g}".format)
        return f"<pre>{html.escape(repr(self))}</pre>{table}"


@dataclass(frozen=True, repr=False)
class DocumentResult(Result):
    """A result that is a document: text, data frame and page are made from it.

    Attributes:
        name: of its files, ``NAME.json`` and, with a page, ``NAME.html``.
        document: content of ``NAME.json``.
        text: of the document, for a terminal.
        rows: of the document, for a data frame.
        page: writes that of the document to a path; ``None``: there is none.
    """

    name: str
    document: Document
    text: Callable[[Document], RenderableType]
    rows: Callable[[Document], Iterable[Mapping[str, Any]]]
    page: Callable[[Document, Path], None] | None = None

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the page, if there is one, and, as the last, the document."""
        document = Path(folder) / f"{self.name}.json"
        # the old document goes first: a run that is stopped leaves none
        begin_results(document.parent, document.name)
        page = document.with_suffix(".html")
        if self.page is not None:
            self.page(self.document, page)
        # last: with it the results are whole
        write_json(self.document, document)
        return (document,) if self.page is None else (page, document)

    def shown(self) -> RenderableType:
        """The document on a terminal."""
        return self.text(self.document)

    def table(self) -> Iterable[Any]:
        """The rows of the document."""
        return self.rows(self.document)


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
        """Write one CSV file; raises ``GapscopeError`` if it cannot be written."""
        check_csv(file)
        write_columns({name: x.to_numpy() for name, x in self.to_frame().items()}, file)
