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

    @cached_property
    def weight(self) -> np.ndarray:
        """Weight of each row, less while a joint may stick, (M, m)."""
        return np.asarray(self.known / (1.0 + self.sticking**2 / self.floor2))

    def of_joint(self, j: int) -> np.ndarray:
        """Rows of X of one joint, by the square root of their weight, (M, P + K + 2)."""
        blocks = [self.terms[:, j], self.inertials[:, j], self.others[:, j]]
        x = np.hstack([*blocks, self.y[:, j, None], self.rate[:, j, None]])
        return np.asarray(x * np.sqrt(self.weight[:, j, None]))

    def halves(self) -> tuple[EquationRows, EquationRows]:
        """The first and the second half of the rows."""
        middle = len(self.y) // 2
        return self._cut(slice(middle)), self._cut(slice(middle, None))

    def _cut(self, rows: slice) -> EquationRows:
        return EquationRows(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True)
class Fold:
    """Normal equations of half a recording, m rows at a time: joints, or both sides of each joint.

    X = [A, N, E, y, d] has P columns for the parameters, K for the nominal inertials and the other nuisances, one for
    the gap, one for the skew.

    Attributes:
        equations: the rows, decimated to about twice the filter's cut-off.
        pieces: number of pieces of equal length into which they are cut, to be divided in two halves.
        sides: with a joint torque sensor the same of 2 n rows, the actuator side of each joint, then the link side.
    """

    equations: EquationRows
    pieces: int
    sides: Fold | None = None

    @property
    def scored(self) -> Fold:
        """What evidence is drawn from: both sides if they are known, the joint's torque otherwise."""
        return self.sides or self

    @cached_property
    def total(self) -> np.ndarray:
        """X^T W X of each joint, (m, P + K + 2, P + K + 2); W weighs rows down while a joint may stick."""
        joints = range(self.equations.y.shape[1])
        return np.array([_gram(self.equations.of_joint(j)) for j in joints])

    @cached_property
    def count(self) -> np.ndarray:
        """Weight of the rows, (m,)."""
        return np.asarray(self.equations.weight.sum(axis=0))

    @property
    def floor(self) -> np.ndarray:
        """RMS that noise, timing and the form of friction leave on this fold [N m], (m,)."""
        return np.sqrt(self.equations.floor2)

    def by_piece(self, places: np.ndarray) -> np.ndarray:
        """X^T W X of some columns of each piece and joint, (pieces, m, C, C)."""
        rows, joints = self.equations.y.shape
        edges = np.linspace(0, rows, self.pieces + 1).astype(int)
        out = np.zeros((self.pieces, joints, len(places), len(places)))
        for j in range(joints):
            x = self.equations.of_joint(j)[:, places]
            for piece, (start, end) in enumerate(itertools.pairwise(edges)):
                out[piece, j] = x[start:end].T @ x[start:end]
        return out


def _gram(x: np.ndarray) -> np.ndarray:
    """X^T X of X (M, D), (D, D); most columns do nothing to one joint, and are left out of the product."""
    out = np.zeros((x.shape[1], x.shape[1]))
    acting = np.flatnonzero(x.any(axis=0))
    within = x[:, acting]
    out[np.ix_(acting, acting)] = within.T @ within
    return out
