"""What the commands say on the terminal: results on standard output, progress and notes on standard error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from rich.status import Status

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
        """Say what is done now."""
        text = f"{self.label}: {message}"
        if self._status:
            self._status.update(text)
        else:
            log.print(text, highlight=False)


def wrote(*paths: Path) -> None:
    """Say what was written."""
    for path in paths:
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)
