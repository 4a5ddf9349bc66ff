"""Output on the terminal: results on standard output, progress and notes on standard error."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from rich.status import Status

    from gapscope.interface.result import Result

# apart, so that results can go into a pipe while progress stays on the screen
console = Console()
log = Console(stderr=True)


class Progress:
    """What is being done: a spinner on a terminal, a line each elsewhere; on standard error."""

    def __init__(self, label: str | Path) -> None:
        """Take a label, or what is worked on: its name, or the path of what has none."""
        self.label = label if isinstance(label, str) else label.name or str(label)
        status = log.status(self.label) if log.is_terminal else None
        self._status: Status | None = status

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


class SearchProgress:
    """How far a search is, and the best value so far: a bar on a terminal, a few lines elsewhere."""

    def __init__(self, label: str, criterion: str) -> None:
        self._label, self._criterion = label, criterion
        self._quarters = -1
        self._bar: Any = None
        if log.is_terminal:
            # a bar is for a screen: in a log it would be a page of lines
            from rich.progress import (
                BarColumn,
                TextColumn,
                TimeRemainingColumn,
            )
            from rich.progress import Progress as Bars

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TimeRemainingColumn(),
            )
            self._bar = Bars(*columns, console=log, transient=True)
            self._task = self._bar.add_task(label, total=1.0)

    def __enter__(self) -> SearchProgress:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def __call__(self, share: float, best: float) -> None:
        """Show the share of the budget spent [1] and the best value of the criterion, or infinity."""
        if self._bar:
            text = f"{self._label}: {self._text(best)}"
            self._bar.update(self._task, completed=share, description=text)
            return
        # in a log a line for each quarter is enough
        quarters = int(4 * share)
        if quarters > self._quarters:
            self._quarters = quarters
            text = f"{self._label}: {share:.0%}, {self._text(best)}"
            log.print(text, highlight=False, markup=False)

    def _text(self, best: float) -> str:
        if not math.isfinite(best):
            return "none within the limits yet"
        # the search minimises the logarithm of these two, the separation's with a minus sign
        if self._criterion == "condition":
            return f"condition {math.exp(best):.3g}"
        if self._criterion == "separation":
            return f"separation {math.exp(-best):.3g}"
        return f"{self._criterion}-criterion {best:.3f}"


def show(result: Result, *written: Path, as_json: bool = False) -> None:
    """Print a result and which files it was written to, or its document alone as JSON."""
    if as_json:
        from gapscope.arm.io.json_file import to_json

        # not by the console, which would break its lines
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
