"""The transmission in the import section of a case: q_motor = R q_joint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError


def per_joint(
    values: Any, n_joints: int, source: Path, key: str, kind: type = float
) -> Any:
    """Values of a list in the import section, one per joint: numbers as an array (n,), texts as a list; else raises."""
    if len(values) != n_joints:
        raise InputError(
            f"expected {n_joints} entries, one per joint, got {len(values)}",
            file=source,
            where=f"field import.{key}",
        )
    return np.array(values, dtype=float) if kind is float else list(map(str, values))


def parse_transmission(
    entry: Mapping[str, Any], n_joints: int, source: Path
) -> np.ndarray:
    """The matrix R of q_motor = R q_joint, (n, n)."""
    where = "field import.transmission"
    has_matrix, has_ratios = "matrix" in entry, "ratios" in entry
    if has_matrix == has_ratios or (has_matrix and "coupling" in entry):
        raise InputError(
            "expected either matrix, or ratios with or without coupling",
            file=source,
            where=where,
        )
    if has_matrix:
        matrix = _full_matrix(entry["matrix"], n_joints, source, where)
    else:
        matrix = _coupled_ratios(entry, n_joints, source, where)
    if np.linalg.matrix_rank(matrix) < n_joints:
        raise InputError(
            "cannot be inverted",
            "each motor has to move a joint",
            file=source,
            where=where,
        )
    return matrix


def _full_matrix(
    rows: list[list[float]], n_joints: int, source: Path, where: str
) -> np.ndarray:
    """A transmission that is given entry by entry, (n, n)."""
    if [len(row) for row in rows] != [n_joints] * n_joints:
        raise InputError(
            f"expected a matrix of {n_joints} by {n_joints} numbers",
            file=source,
            where=f"{where}.matrix",
        )
    return np.array(rows, dtype=float)


def _coupled_ratios(
    entry: Mapping[str, Any], n_joints: int, source: Path, where: str
) -> np.ndarray:
    """A transmission by gear ratios and the motors that move with another joint, (n, n)."""
    ratios = per_joint(entry["ratios"], n_joints, source, "transmission.ratios")
    matrix = np.diag(ratios)
    for number, coupling in enumerate(entry.get("coupling", []), start=1):
        motor, joint = coupling["motor"], coupling["joint"]
        if max(motor, joint) > n_joints or motor == joint:
            raise InputError(
                f"expected two different numbers from 1 to {n_joints}",
                file=source,
                where=f"{where}.coupling[{number}]",
            )
        matrix[motor - 1, joint - 1] = coupling["ratio"]
    return matrix
