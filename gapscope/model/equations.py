"""Sums of products of columns and gap, per motion, group and joint: all that a contrast asks is algebra on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri, dtrtrs

from gapscope.model.design import Design


@dataclass(frozen=True)
class Cell:
    """Rows of one motion in one group, on one joint.

    Attributes:
        motion, group, recording: numbers; of a motion that comes again, the first recording.
        rows: numbers of the rows, (m,).
        root: no more than p rows with the products of the columns X, (min(m, p), p).
        right: X^T y, (p,).
        power: y^T y.
        count: rows that count, the sum of their weights.
    """

    motion: int
    group: int
    recording: int
    rows: np.ndarray
    root: np.ndarray
    right: np.ndarray
    power: float
    count: float

    @property
    def gram(self) -> np.ndarray:
        """X^T X, (p, p)."""
        return self.root.T @ self.root


@dataclass(frozen=True)
class Equations:
    """The cells of each joint; columns in the order of the joint's own.

    Attributes:
        design: columns and gap.
        cells: of each joint, motion by motion.
        noise2: variance of the noise of each joint [1], (n,), if known.
    """

    design: Design
    cells: list[list[Cell]]
    noise2: np.ndarray | None = None

    @classmethod
    def of(cls, design: Design, noise2: np.ndarray | None = None) -> Equations:
        """The sums of a design, over the rows that are not set aside.

        Args:
            design: columns and gap.
            noise2: variance of the noise of each joint [1], (n,), if known. A column made of the recorded torque holds
                the noise that is in the gap: what they have in common by that is taken out.
        """
        rows = design.rows
        numbers = np.column_stack([rows.motion, rows.group])
        members = [
            (
                motion,
                group,
                np.flatnonzero((rows.motion == motion) & (rows.group == group)),
            )
            for motion, group in np.unique(numbers[~rows.set_aside], axis=0).tolist()
        ]
        cells = [
            [
                _cell(
                    motion,
                    group,
                    int(rows.recording[own[0]]),
                    own,
                    x[own],
                    design.gap[own, j],
                    rows.trust[own, j],
                )
                for motion, group, own in members
            ]
            for j, x in enumerate(design.columns)
        ]
        made = cls(design, cells, noise2)
        for j, own in enumerate(cells):
            for cell in own:
                made.take_noise(j, cell.rows, cell.right)
        return made

    def take_noise(self, j: int, rows: np.ndarray, right: np.ndarray) -> None:
        """Take from a right side what columns made of the recorded torque have in common with the gap by its noise."""
        if self.noise2 is None:
            return
        for (joint, place), passed in self.design.noisy.items():
            if joint == j:
                right[place] -= self.noise2[j] * passed[rows].sum()


def _cell(
    motion: int,
    group: int,
    recording: int,
    rows: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    trust: np.ndarray,
) -> Cell:
    power, count = float(y @ y), float(trust @ trust)
    root = x if len(x) <= x.shape[1] else np.asarray(np.linalg.qr(x, mode="r"))
    return Cell(motion, group, recording, rows, root, x.T @ y, power, count)


def lower(matrix: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of I + a matrix, which is written over.

    Raises:
        LinAlgError: the sum is not positive definite.
    """
    matrix[np.diag_indices(len(matrix))] += 1.0
    return _cholesky(matrix)


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    # the matrices are small and many: what checks their shape would cost more than they do
    factor, failed = dpotrf(matrix, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return np.asarray(factor)


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """L^-1 of a lower triangular factor times a right side."""
    if not right.size:
        return np.array(right, dtype=float)
    return np.asarray(dtrtrs(factor, right, lower=1)[0])


def inverse(factor: np.ndarray) -> np.ndarray:
    """L^-1 of a lower triangular factor."""
    return np.asarray(dtrtri(factor, lower=1)[0])


def whitened(cell: Cell, own2: np.ndarray, noise2: float) -> np.ndarray:
    """Rows W with W^T W the information on the joint's columns beside what a motion has of its own, (k, p).

    W = L^-1 X with L L^T = noise2 I + X diag(own2) X^T: of motions of few rows a small matrix.
    """
    X = cell.root
    covariance = (X * own2) @ X.T
    covariance[np.diag_indices(len(X))] += noise2
    return forward(_cholesky(covariance), X)


@dataclass(frozen=True)
class Eliminated:
    """One motion of a group on one joint, what it has of its own eliminated.

    Attributes:
        cell: the motion.
        free: places of the columns of which it has values of its own, among the joint's.
        size: their deviations.
        factor: L with L L^T = I + the information on them in units of their deviations.
        cross: L^-1 times their products with all columns, (k, p).
        right: L^-1 times their products with the gap, (k,).
        noise2: variance of the noise.
    """

    cell: Cell
    free: np.ndarray
    size: np.ndarray
    factor: np.ndarray
    cross: np.ndarray
    right: np.ndarray
    noise2: float

    @property
    def root_of_own(self) -> np.ndarray:
        """Rows with the products of the columns of its own, in units of their deviations, (min(r, k), k)."""
        own = self.cell.root[:, self.free] * self.size
        return own if len(own) <= len(self.free) else np.asarray(np.linalg.qr(own, "r"))

    @property
    def information(self) -> np.ndarray:
        """Information on the coefficients of the joint's columns, (p, p)."""
        return self.cell.gram / self.noise2 - self.cross.T @ self.cross

    @property
    def pull(self) -> np.ndarray:
        """Its right side, (p,)."""
        return self.cell.right / self.noise2 - self.cross.T @ self.right

    def inner(self, products: np.ndarray) -> np.ndarray:
        """L^-1 times the products of the own values with further columns, of all columns' products (p, K)."""
        return forward(self.factor, self.size[:, None] * products[self.free])


def eliminated(cell: Cell, own2: np.ndarray, noise2: float) -> Eliminated:
    """Eliminate what a motion has of its own, of variance ``own2``, (p,)."""
    free = np.flatnonzero(own2 > 0)
    size = np.sqrt(own2[free])
    own = cell.root[:, free] * size
    factor = lower(own.T @ own / noise2)
    cross = forward(factor, own.T @ cell.root / noise2)
    right = forward(factor, size * cell.right[free] / noise2)
    return Eliminated(cell, free, size, factor, cross, right, noise2)
