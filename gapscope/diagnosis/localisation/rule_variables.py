"""The quantities that a rule may speak of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.thresholds import STILL_QUANTILE


@dataclass(frozen=True)
class RuleVariable:
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


def rule_variables(rows: MotionRows, load: np.ndarray, j: int) -> list[RuleVariable]:
    """Of joint j (from 0): speed, direction (-1, 0, 1), |nominal torque|, |acceleration|, position, time; each (M,)."""
    velocity = rows.dq[:, j]
    speed = np.abs(velocity)
    moves = speed > np.quantile(speed, STILL_QUANTILE)
    direction = np.where(moves, np.sign(velocity), 0.0)
    return [
        RuleVariable("speed", "|dq|", "rad/s", speed),
        RuleVariable("direction", "direction", "", direction),
        RuleVariable("load", "|load|", "N m", np.abs(load[:, j])),
        RuleVariable("acceleration", "|ddq|", "rad/s²", np.abs(rows.ddq[:, j])),
        RuleVariable("position", "q", "rad", rows.q[:, j]),
        RuleVariable("time", "t", "s", rows.clock),
    ]
