"""Curves of a diagnosis for its report, and values by instruments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.locate import MotionRows

KNOTS = 16
"""Knots of a curve, at equal shares of the samples and of the range in turn."""
MOVING = 0.02
"""A joint moves in a direction when it is faster than about this [rad/s]."""
SMOOTH = 0.02
"""Weight of a curve's second differences, over the number of samples per knot."""


@dataclass(frozen=True)
class Curve:
    """The gap over one variable: x in ``unit``, y [N m], each (K,)."""

    variable: str
    unit: str
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Variable:
    """One variable of a joint at every row.

    Attributes:
        name: ``position``, ``velocity``, ``speed``, ``direction``, ``acceleration``, ``load`` or ``time``.
        unit: its unit.
        values: shape (M,).
    """

    name: str
    unit: str
    values: np.ndarray

    @property
    def knots(self) -> np.ndarray:
        """Knots of a curve over the variable, ascending, (K,)."""
        # A direction is -1 or 1, hardly ever between.
        if self.name == "direction":
            return np.array([-1.0, 0.0, 1.0])
        low, high = float(self.values.min()), float(self.values.max())
        if low == high:
            return np.array([low - 1.0, low + 1.0])

        quantiles = np.quantile(self.values, np.linspace(0.0, 1.0, KNOTS))
        even = np.linspace(low, high, KNOTS)
        # Even in samples alone, knots would be rare at the ends; even in range alone, some would hold no sample.
        return np.asarray(0.5 * (quantiles + even))

    def hats(self) -> np.ndarray:
        """Hat functions over the knots: a curve through values at the knots is linear in them; (M, K)."""
        knots = self.knots
        columns = []
        for heights in np.eye(len(knots)):
            columns.append(np.interp(self.values, knots, heights))
        return np.column_stack(columns)

    def smooth(self) -> list[np.ndarray]:
        """Smooth functions of the variable for a model of many variables; each (M,)."""
        # Angles repeat after a turn.
        if self.name == "position":
            return [np.sin(self.values), np.cos(self.values)]
        # A speed is no smooth function of the velocity, and follows from it.
        if self.name == "speed":
            return []
        return [self.values]


def variables(
    rows: MotionRows, kept: np.ndarray, j: int, load: np.ndarray
) -> list[Variable]:
    """The variables of joint j (from 0) on the rows kept, (M,).

    ``speed`` is dq without its sign, ``velocity`` with it, ``load`` the torque that the corrected arm predicts,
    ``time`` counts from the start of each recording.
    """
    v = rows.dq[kept, j]
    return [
        Variable("position", "rad", rows.q[kept, j]),
        Variable("speed", "rad/s", np.abs(v)),
        Variable("velocity", "rad/s", v),
        Variable("direction", "1", np.tanh(v / MOVING)),
        Variable("acceleration", "rad/s^2", rows.ddq[kept, j]),
        Variable("load", "N m", load),
        Variable("time", "s", rows.clock[kept]),
    ]


def curve_of(variable: Variable, gap: np.ndarray) -> Curve:
    """The smooth curve nearest to a gap [N m], (M,): least squares on hats with second differences held small."""
    hats, knots = variable.hats(), variable.knots

    identity = np.eye(len(knots))
    bends = np.diff(identity, 2, axis=0)
    weight = SMOOTH * len(gap) / len(knots)

    # The last term decides at knots without samples.
    least = 1e-9 * len(gap) * identity
    gram = hats.T @ hats + weight * bends.T @ bends + least

    heights = np.linalg.solve(gram, hats.T @ gap)
    return Curve(variable.name, variable.unit, knots, heights)
