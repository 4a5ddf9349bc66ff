"""The residual of all joints, for effects that no column of the linearisation represents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ScanResidual:
    """What the nominal inertials and the plainest effects leave of the gap, M rows.

    Attributes:
        residual: per joint [N m], weighted by trust, (M, n).
        bases: per joint what was taken out of it, orthonormal columns, (M, K).
        trust: square root of the weight of each row, (M, n).
        information: nats per square of the gap [1/(N m)^2], (n,).
    """

    residual: np.ndarray
    bases: list[np.ndarray]
    trust: np.ndarray
    information: np.ndarray

    def gain(self, torque: np.ndarray, free: np.ndarray | None = None) -> float:
        """What a predicted torque, (M, n), explains of the residual, without any factor [nats].

        Args:
            torque: per joint [N m]; joints with none do not count.
            free: one more column per joint that takes its own best value.
        """
        gain = 0.0
        for j in np.flatnonzero(torque.any(axis=0)):
            change, residual = self._outside_basis(torque, j), self.residual[:, j]
            if free is not None:
                column = self._outside_basis(free, j)
                column = column / max(float(np.linalg.norm(column)), 1e-12)
                change = change - column * (column @ change)
                residual = residual - column * (column @ residual)
            # |r|^2 / 2 - |r - c|^2 / 2
            fallen = float(residual @ change - 0.5 * change @ change)
            gain += self.information[j] * fallen
        return gain

    def _outside_basis(self, torque: np.ndarray, j: int) -> np.ndarray:
        """Weighted torque of joint j less its projection on what was taken out, (M,)."""
        weighted, basis = torque[:, j] * self.trust[:, j], self.bases[j]
        return weighted - basis @ (basis.T @ weighted)
