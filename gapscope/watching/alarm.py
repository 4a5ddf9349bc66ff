"""What a watch says: an alarm, a misfit, a drift or a note, as one JSON line and as a sentence."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from gapscope.arm.io.json_file import plain

SCHEMA = 1
"""Version of the form of the lines."""
ALARM, MISFIT, DRIFT, NOTE = "alarm", "misfit", "drift", "note"
"""Kinds of events."""


@dataclass(frozen=True)
class Size:
    """A value with its standard error.

    Attributes:
        value, std: in the unit.
        unit: SI.
    """

    value: float
    std: float
    unit: str

    def __str__(self) -> str:
        """With sign and unit."""
        return f"{self.value:+.3g} ± {self.std:.2g} {self.unit}"


@dataclass(frozen=True)
class Event:
    """Something that a watch has to say.

    Attributes:
        event: ``alarm``, ``misfit``, ``drift`` or ``note``.
        effect: what changed: ``payload``, ``friction``, ``torque_offset``, ``encoder_offset`` or ``other``; empty for
            a note.
        change: in a word or two: ``picked up``, ``risen``; empty for a note.
        joints: from 1; empty for the whole arm.
        recording: in which it happened.
        time: when it began, in the recording's time [s]; ``None`` if it has none.
        interval: in which it began [s], or ``None``.
        detected: time of the last sample that was known [s], or ``None``.
        sizes: by name of the parameter.
        evidence: numbers that led to it.
        alternatives: what else would explain it nearly as well.
        sentence: the same for a reader.
    """

    event: str
    sentence: str
    effect: str = ""
    change: str = ""
    joints: Sequence[int] = ()
    recording: str = ""
    time: float | None = None
    interval: tuple[float, float] | None = None
    detected: float | None = None
    sizes: Mapping[str, Size] = field(default_factory=dict)
    evidence: Mapping[str, float] = field(default_factory=dict)
    alternatives: Sequence[Mapping[str, Any]] = ()

    def as_line(self, number: int) -> str:
        """One line of JSON in the form of ``event.schema.json``, without the new line.

        Args:
            number: of the event, from 1, counted over all runs of a watch.
        """
        content = {"schema": SCHEMA, "number": number, **asdict(self)}
        return json.dumps(plain(content), ensure_ascii=False, allow_nan=False)
