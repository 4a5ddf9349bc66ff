"""The parts of the benchmarks, by name."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from types import ModuleType

from experiments.benchmarks.point import Point, Settings
from experiments.benchmarks.row import Row

PARTS = {
    "startup": "Start-up",
    "regressor": "Regressor and base parameters",
    "identification": "Identification",
    "joint": "Friction and inertia of one joint",
    "diagnosis": "Diagnosis",
    "watch": "Watching a recording that grows",
    "environment": "Environment and agents",
}
"""Title of each part in the table; its module has the part's name."""


def _module(part: str) -> ModuleType:
    return import_module(f"experiments.benchmarks.{part}")


def points_of(part: str, settings: Settings) -> list[Point]:
    """What a part measures; its module is imported for it."""
    return list(_module(part).points(settings))


def conclusions_of(part: str, rows: Iterable[Row]) -> list[Row]:
    """Rows that follow from all rows of a part, for instance an exponent; its module may have ``conclusions(rows)``."""
    conclude = getattr(_module(part), "conclusions", None)
    return list(conclude(list(rows))) if conclude else []
