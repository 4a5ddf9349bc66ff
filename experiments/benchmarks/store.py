"""Measured points as JSON, one file each, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path

from experiments.benchmarks.machine import machine
from experiments.benchmarks.point import Point
from experiments.benchmarks.row import Row
from gapscope.arm.io.json_file import read_json, write_json


def point_file(folder: Path, part: str, name: str) -> Path:
    """Where a point is stored."""
    return folder / "points" / part / (re.sub(r"[^\w.-]+", "_", name) + ".json")


def stored(path: Path) -> list[Row] | None:
    """The rows of a point; ``None`` if it has not been measured."""
    if not path.is_file():
        return None
    content = read_json(path, "remove the file: the point is then measured again")
    return [Row(**row) for row in content["rows"]]


def measured(path: Path, part: str, point: Point) -> list[Row]:
    """Measure a point, and store its rows once it is done."""
    rows = list(point.measure())
    content = {"part": part, "point": point.name, "machine": machine()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json({**content, "rows": [asdict(row) for row in rows]}, path)
    return rows
