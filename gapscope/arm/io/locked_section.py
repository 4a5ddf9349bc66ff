"""The ``locked:`` section of a case: where joints stand that are none of the arm's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.case_paths import CasePaths
from gapscope.arm.io.log import open_log


def locked_positions(content: Mapping[str, Any], paths: CasePaths) -> dict[str, float]:
    """Positions of locked joints [rad or m], by name.

    A number is the position; a text names a column of the first recording, whose mean is taken.

    Raises:
        InputError: no table of that recording has the column.
    """
    section = content.get("locked") or {}
    columns = {name: entry for name, entry in section.items() if isinstance(entry, str)}
    positions = {name: entry for name, entry in section.items() if name not in columns}
    if not columns:
        return {name: float(position) for name, position in positions.items()}
    first = paths.entry(content["recordings"][0], "recordings")
    files = [first] if not isinstance(first, dict) else list(first.values())
    tables = [table.table for file in files for table in open_log(file).tables]
    for name, column in columns.items():
        holding = [table for table in tables if column in table.columns]
        if not holding:
            raise InputError(
                f"no table of {', '.join(str(file) for file in files)} has a column {column!r}",
                "name a column, or give the position as a number",
                file=paths.file,
                where=f"field locked.{name}",
            )
        positions[name] = np.mean(holding[0].numbers(column))
    return {name: float(positions[name]) for name in section}
