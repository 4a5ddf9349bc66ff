"""Half a recording as normal equations: all that a fit needs of it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class EquationRows:
    """Rows of X = [A, N, E, y, d] and what is known of them, M times m: joints, or both sides of each joint.

    Attributes:
        terms: A, derivatives by the terms' coordinates, (M, m, P).
        inertials: N, the nominal inertial regressor in units of its errors, (M, m, 10 n).
        others: E, derivatives by further nuisances: errors of the joint torque sensors in units of their spread,
            (M, m, 3 n), or what a reference leaves open of the joints' parameters and of their gains, (M, m, q + n).
        y: gap plus A theta_0 [N m], (M, m).
        rate: d, what a skew of sampling adds [N m/s], (M, m).
        sticking: RMS that dry friction may leave beyond the floor while the joint may stick [N m], (M, m).
        steady2: mean square of a healthy arm [N^2 m^2], (M, m).
        known: 1 for rows that were measured, 0 for others, (M, m).
    """

    terms: np.ndarray
    inertials: np.ndarray
    others: np.ndarray
    y: np.ndarray
    rate: np.ndarray
    sticking: np.ndarray
    steady2: np.ndarray
    known: np.ndarray

    @property
    def floor2(self) -> np.ndarray:
        """Mean square of a healthy arm on these rows [N^2 m^2], (m,)."""
        return np.asarray(self.steady2.mean(axis=0))

    @property
    def weight(self) -> np.ndarray:
        """Weight of each row, less while a joint may stick, (M, m)."""
        return np.asarray(self.known / (1.0 + self.sticking**2 / self.floor2))

    @property
    def stacked(self) -> np.ndarray:
        """X, (M, m, P + K + 2)."""
        blocks = [self.terms, self.inertials, self.others]
        return np.concatenate(
            [*blocks, self.y[:, :, None], self.rate[:, :, None]], axis=2
        )

    def halves(self) -> tuple[EquationRows, EquationRows]:
        """The first and the second half of the rows."""
        middle = len(self.y) // 2
        return self._cut(slice(middle)), self._cut(slice(middle, None))

    def _cut(self, rows: slice) -> EquationRows:
        return EquationRows(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True)
class Fold:
    """Normal equations of half a recording, B pieces in time, n joints.

    X = [A, N, y, d] has P columns for the parameters, K for the nominal inertials and the sensors' errors, one for the
    gap, one for the skew.

    Attributes:
        gram: X^T W X per piece and joint, shape (B, n, P + K + 2, P + K + 2); W weighs rows down while a joint may
            stick.
        rows: weight of the rows of each piece, decimated to about twice the filter's cut-off, shape (B, n).
        floor: RMS that noise, timing and the form of friction leave on this fold [N m], (n,).
        sides: with a joint torque sensor the same of 2 n rows, the actuator side of each joint, then the link side.
    """

    gram: np.ndarray
    rows: np.ndarray
    floor: np.ndarray
    sides: Fold | None = None

    @property
    def scored(self) -> Fold:
        """What evidence is drawn from: both sides if they are known, the joint's torque otherwise."""
        return self.sides or self

    @cached_property
    def total(self) -> np.ndarray:
        """X^T W X of all pieces per joint, (n, P + K + 2, P + K + 2)."""
        return np.asarray(self.gram.sum(axis=0))

    @cached_property
    def count(self) -> np.ndarray:
        """Weight of the rows of all pieces, (n,)."""
        return np.asarray(self.rows.sum(axis=0))


def fold_of(rows: EquationRows, count: int) -> Fold:
    """Normal equations of rows, in ``count`` pieces of equal length."""
    weight = rows.weight
    # one joint after the other: (m, M, P + K + 2)
    weighted = (rows.stacked * np.sqrt(weight)[:, :, None]).transpose(1, 0, 2)
    grams, weights = [], []
    edges = np.linspace(0, len(weight), count + 1).astype(int)
    for start, end in itertools.pairwise(edges):
        piece = weighted[:, start:end]
        grams.append(piece.transpose(0, 2, 1) @ piece)
        weights.append(weight[start:end].sum(axis=0))
    return Fold(np.array(grams), np.array(weights), np.sqrt(rows.floor2))
