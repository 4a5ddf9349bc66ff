"""The quantities that a rule may speak of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.localisation.stacked_rows import Rows
from gapscope.diagnosis.thresholds import STILL_QUANTILE


@dataclass(frozen=True)
class Quantity:
    """One quantity at every row.

    Attributes:
        name: in the document: ``speed``, ``direction``, ``load``, ``acceleration``, ``position`` or ``time``.
        symbol, unit: in words.
        values: shape (M,).
    """

    name: str
    symbol: str
    unit: str
    values: np.ndarray


def quantities(rows: Rows, load: np.ndarray, j: int) -> list[Quantity]:
    """Of joint j (from 0): speed, direction (-1, 0, 1), |nominal torque|, |acceleration|, position, time; each (M,)."""
    v = rows.dq[:, j]
    speed = np.abs(v)
    direction = np.where(speed > np.quantile(speed, STILL_QUANTILE), np.sign(v), 0.0)
    return [
        Quantity("speed", "|dq|", "rad/s", speed),
        Quantity("direction", "direction", "", direction),
        Quantity("load", "|load|", "N m", np.abs(load[:, j])),
        Quantity("acceleration", "|ddq|", "rad/s²", np.abs(rows.ddq[:, j])),
        Quantity("position", "q", "rad", rows.q[:, j]),
        Quantity("time", "t", "s", rows.clock),
    ]
