"""Base parameters in orthonormal combinations, by singular value decomposition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.rank import DEPENDENT, gap_at, rank_by_gap, unit_triangle


@dataclass(frozen=True)
class OrthonormalBase:
    """Base parameters gamma = V1^T pi, co-ordinates of pi in the row space of Y; b of p parameters.

    The pi of least norm with the same torque is V1 gamma.

    Attributes:
        names: names of pi, shape (p,).
        basis: V1, shape (p, b), orthonormal columns.
        singular_values: of the unit columns of Y, shape (p,), falling; empty if not known.

    Source: gautier1991.
    """

    names: tuple[str, ...]
    basis: np.ndarray
    singular_values: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.basis.shape[1]

    @property
    def gap(self) -> float:
        """Smallest singular value that counts over the largest that does not."""
        return gap_at(self.singular_values, self.count)

    def of(self, parameters: np.ndarray) -> np.ndarray:
        """Gamma = V1^T pi, shape (b,)."""
        return self.basis.T @ parameters

    def spread(self, gamma: np.ndarray) -> np.ndarray:
        """Pi = V1 gamma, the shortest with this torque; shape (p,)."""
        return self.basis @ gamma

    def matrix(self, Y: np.ndarray) -> np.ndarray:
        """Y V1, the regressor of gamma, shape (..., b), of Y of shape (..., p)."""
        return Y @ self.basis

    def to_base(self, base: BaseParameters) -> np.ndarray:
        """T with beta = T gamma, shape (b, b)."""
        return base.combination @ self.basis

    def from_base(self, base: BaseParameters) -> np.ndarray:
        """T with gamma = T beta, shape (b, b)."""
        return np.linalg.inv(self.to_base(base))


def orthonormal_base(
    Y: np.ndarray, names: Sequence[str], tolerance: float = DEPENDENT
) -> OrthonormalBase:
    """Base parameters by singular value decomposition of a regressor of enough random samples.

    The right singular vectors of the unit columns that belong to values behind the gap, scaled back, span the pi
    without torque; V1 spans what is orthogonal to them.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns.
        tolerance: largest singular value that can count as nil.

    Raises:
        InputError: values that are not finite, fewer rows than columns, or a regressor of zeros.

    Source: gautier1991.
    """
    names = tuple(names)
    scaled, norms = unit_triangle(Y, names)
    _, values, right = np.linalg.svd(scaled)
    count = rank_by_gap(values, tolerance)
    without_torque = right[count:].T / norms[:, None]
    unit = without_torque / np.linalg.norm(without_torque, axis=0)
    # a complete Q spans the pi without torque first, and then their orthogonal complement
    full = np.linalg.qr(unit, mode="complete")[0]
    return OrthonormalBase(names, full[:, len(names) - count :], values)
