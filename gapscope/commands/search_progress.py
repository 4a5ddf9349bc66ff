"""Progress of a search for a trajectory."""

from __future__ import annotations

import math

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


class SearchProgress:
    """How far a search is, and the best value so far: a bar on a terminal, a few lines elsewhere."""

    def __init__(self, label: str, criterion: str, console: Console) -> None:
        self._label = label
        self._criterion = criterion
        self._console = console
        self._quarters = -1
        self._bar: Progress | None = None
        if console.is_terminal:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TimeRemainingColumn(),
            )
            self._bar = Progress(*columns, console=console, transient=True)
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
        quarters = int(4 * share)
        if quarters > self._quarters:
            self._quarters = quarters
            text = f"{self._label}: {share:.0%}, {self._text(best)}"
            self._console.print(text, highlight=False, markup=False)

    def _text(self, best: float) -> str:
        if not math.isfinite(best):
            return "none within the limits yet"
        # the search minimises the logarithm of these two, the separation's with a minus sign
        if self._criterion == "condition":
            return f"condition {math.exp(best):.3g}"
        if self._criterion == "separation":
            return f"separation {math.exp(-best):.3g}"
        return f"{self._criterion}-criterion {best:.3f}"
