"""A row of the troubleshooting table: its text, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FOUND, CLEAR = "found", "clear"


@dataclass(frozen=True)
class Entry:
    """The text of a row of the table, whatever the data.

    Attributes:
        key: name of the row.
        symptom: what one sees.
        cause: what is behind it.
        check: how the data show it.
        remedy: what to do.
    """

    key: str
    symptom: str
    cause: str
    check: str
    remedy: str


@dataclass(frozen=True)
class Row:
    """A row of the table, filled in.

    Attributes:
        entry: its text.
        measured: the number that the check gave; the worst joint's.
        threshold: beyond which the row is found.
        unit: of both.
        verdict: ``found`` or ``clear``.
        joints: where, from 1.
    """

    entry: Entry
    measured: float
    threshold: float
    unit: str
    verdict: str
    joints: tuple[int, ...] = ()


def make_row(
    entry: Entry,
    value: np.ndarray | float,
    threshold: float,
    unit: str = "1",
    *,
    below: bool = False,
) -> Row:
    """A row that is found if a value per joint exceeds the threshold, or falls below it if ``below``."""
    per_joint = np.ndim(value) > 0
    values = np.atleast_1d(np.asarray(value, dtype=float))
    if below:
        found, worst = values < threshold, values.min()
    else:
        found, worst = values > threshold, values.max()
    joints: tuple[int, ...] = ()
    if per_joint:
        joints = tuple(int(j) + 1 for j in np.flatnonzero(found))
    status = FOUND if found.any() else CLEAR
    return Row(
        entry=entry,
        measured=float(worst),
        threshold=threshold,
        unit=unit,
        verdict=status,
        joints=joints,
    )
