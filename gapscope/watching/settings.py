"""What a user chooses about a watch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.watching.detector import LEARN, LEAST_BLOCKS
from gapscope.watching.segments import BLOCK

LEAST_LEARNING = LEAST_BLOCKS * BLOCK
"""Motion to learn from at least [s]."""


@dataclass(frozen=True)
class WatchSettings:
    """What a user chooses about a watch.

    Attributes:
        source: file or folder to follow.
        out: folder for alarms and state; ``None``: neither is written.
        learning: motion from which normal behaviour is learnt [s]; 0: the case's recordings show it.
        false_alarms: wanted per 24 h of motion at most, if the model had no errors.
        rest: time without a write after which a file in a folder is complete [s].
        until_idle: end when nothing new came for this long [s]; ``None``: never; 0: at once.
        poll: time between two looks at the source [s].

    Raises:
        InputError: a number is out of range.
    """

    source: Path
    out: Path | None = None
    learning: float = LEARN
    false_alarms: float = 0.1
    rest: float = 5.0
    until_idle: float | None = None
    poll: float = 0.5

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.learning and self.learning < LEAST_LEARNING:
            raise InputError(
                f"expected at least {LEAST_LEARNING:g} s to learn from, or 0 for the case's recordings, "
                f"got {self.learning:g}",
                where="--learn",
            )
        if self.false_alarms <= 0:
            raise InputError(
                f"expected a number above 0, got {self.false_alarms:g}",
                where="--false-alarms",
            )
