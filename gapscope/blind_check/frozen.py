"""What fixes a run: the hash of what leads to a diagnosis, its thresholds, and the versions."""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

from gapscope.diagnosis import thresholds
from gapscope.provenance import library_versions, source_hash


def threshold_values() -> dict[str, Any]:
    """Value of each constant of ``gapscope.diagnosis.thresholds``, as JSON can hold it."""
    return {
        name: _plain(value)
        for name, value in vars(thresholds).items()
        if name.isupper()
    }


def frozen() -> dict[str, Any]:
    """What a run is fixed by."""
    return {
        "source_sha256": source_hash(),
        "thresholds": threshold_values(),
        "python": platform.python_version(),
        "libraries": library_versions(),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {str(key): item for key, item in value.items()}
    return value
