"""Logs in other people's columns, written and inspected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from gapscope.arm.io.log import open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.inspection.inspection import Inspection, inspect_logs


def columns(pattern: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """One column for each joint; ``{j}`` and ``{j0}`` in the pattern are its number from 1 and from 0."""
    return {pattern.format(j=j + 1, j0=j): column for j, column in enumerate(values.T)}


def case_format(r: Recording) -> dict[str, np.ndarray]:
    return {
        "t": r.t,
        **columns("q{j}", r.q),
        **columns("dq{j}", r.dq),
        **columns("tau{j}", r.tau),
    }


def inspected(folder: Path, arm: NominalArm | None, **tables: object) -> Inspection:
    """Tables written as CSV files and inspected."""
    logs = []
    for name, table in tables.items():
        path = folder / f"{name}.csv"
        pd.DataFrame(table).to_csv(path, index=False)
        logs.append(open_log(path))
    return inspect_logs(logs, arm)
