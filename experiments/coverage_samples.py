"""The sample cases, from a simulator that shares no code with the project; see ``51_interval_coverage.py``."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Sample:
    """One sample case.

    Attributes:
        name: of the case.
        folder: where it is.
        robot: name of its arm.
        truth: its label.
    """

    name: str
    folder: Path
    robot: str
    truth: dict[str, Any]


def planned() -> list[Sample]:
    """The sample cases below ``GAPSCOPE_DATA``; none if it is not set."""
    data = os.environ.get("GAPSCOPE_DATA")
    if data is None:
        return []
    here = Path(data) / "sample_cases"
    labels = json.loads((here / "labels.json").read_text(encoding="utf-8"))
    return [
        Sample(f"sample_{one['case']}", here / one["case"], one["robot"], one)
        for one in labels
    ]
