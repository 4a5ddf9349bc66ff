"""Output on the terminal: results on standard output, progress and notes on standard error."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from rich.status import Status

    from gapscope.interface.result import Result

console = Console()
log = Console(stderr=True)


class Progress:
    """What is being done: a spinner on a terminal, a line each elsewhere; on standard error."""

    def __init__(self, label: str) -> None:
        self.label = label
        self._status: Status | None = log.status(label) if log.is_terminal else None

    def __enter__(self) -> Progress:
        if self._status:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status:
            self._status.stop()

    def __call__(self, message: str) -> None:
        """Show what is done now."""
        text = f"{self.label}: {message}"
        if self._status:
            self._status.update(text)
        else:
            log.print(text, highlight=False)


def show(result: Result, *written: Path, as_json: bool = False) -> None:
    """Print a result and which files it was written to, or its document alone as JSON."""
    if as_json:
        from gapscope.arm.io.json_file import to_json

        sys.stdout.write(to_json(result.document))  # type: ignore[attr-defined]
        return
    console.print(result.shown())
    wrote(*written)


def say(*lines: str) -> None:
    """Print lines of a result as they are: no markup, no colours of numbers, no line breaks."""
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def note(message: str, style: str | None = None) -> None:
    """Print a line on standard error as it is."""
    log.print(message, style=style, highlight=False, markup=False, soft_wrap=True)


def wrote(*paths: Path) -> None:
    """Print which files were written."""
    say(*(f"wrote {path}" for path in paths))
