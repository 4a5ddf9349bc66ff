"""Coupled motors: those that turn several joints, as in a wrist whose drives share their axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known

KEYS = ("motor", "joint", "ratio")
"""What an entry of ``nominal.coupling`` may say."""


def coupling_of_entries(
    entries: Sequence[Mapping[str, Any]], n_joints: int, where: str
) -> np.ndarray:
    """The matrix D of motor speeds w = D dq [1], (n, n), from the entries of a data sheet.

    Each says which motor turns with a further joint, and by how many turns for one turn of that joint, counted on the
    side of the joint of its own number; one turn by default.

    Raises:
        InputError: an entry names a joint that does not exist, or a motor's own joint, or holds no number.
    """
    matrix = np.eye(n_joints)
    for number, entry in enumerate(entries, start=1):
        place = f"{where}[{number}]"
        remedy = "write for instance {motor: 6, joint: 5, ratio: 1}"
        if not isinstance(entry, Mapping):
            raise InputError(f"expected an entry, got {entry!r}", remedy, where=place)
        for key in entry:
            check_known("entry of a coupling", str(key), KEYS, where=place)
        motor, joint = entry.get("motor", 0), entry.get("joint", 0)
        places = range(1, n_joints + 1)
        if motor not in places or joint not in places or motor == joint:
            raise InputError(
                f"expected motor and joint, two different numbers from 1 to {n_joints}",
                remedy,
                where=place,
            )
        ratio = entry.get("ratio", 1.0)
        if isinstance(ratio, bool) or not isinstance(ratio, int | float) or not ratio:
            raise InputError(
                f"ratio {ratio!r} is no number other than 0", remedy, where=place
            )
        matrix[int(motor) - 1, int(joint) - 1] = float(ratio)
    return matrix


def coupling_of_transmission(
    transmission: np.ndarray, signs: np.ndarray | float = 1.0
) -> np.ndarray:
    """The matrix D of motor speeds w = D dq [1], (n, n), from R of q_motor = R q_joint, (n, n), and the log's signs.

    A motor's row is divided by its ratio to the joint of its own number; a motor that does not turn that joint has no
    side to count on, and no row but that of the joint.
    """
    # the matrix has the log's directions, D those of the URDF
    rows = transmission * signs
    matrix = np.eye(len(rows))
    for motor, row in enumerate(rows):
        if row[motor] != 0:
            matrix[motor] = row / row[motor]
    return matrix


def coupling_entries(matrix: np.ndarray) -> list[dict[str, Any]]:
    """The entries of a data sheet that say the same as D, (n, n)."""
    return [
        {"motor": int(m) + 1, "joint": int(j) + 1, "ratio": float(matrix[m, j])}
        for m, j in zip(*np.nonzero(matrix), strict=True)
        if m != j
    ]
