"""Equations of each joint as a triangle: all that least squares with any weights of the joints need of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.linear_estimator import Factor, least_noise
from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class JointTriangles:
    """Equations W_j beta = tau_j of n joints, rotated: |tau_j - W_j beta|^2 = |z_j - R_j beta|^2 for any beta.

    Attributes:
        names: of the parameters, (b,).
        rows: [R_j, z_j] of each joint, b + 1 rows at most, b + 1 columns.
        samples: N, equations of each joint.
    """

    names: tuple[str, ...]
    rows: tuple[np.ndarray, ...]
    samples: int

    @classmethod
    def of(cls, problem: Problem) -> JointTriangles:
        """Those of a problem."""
        joints = range(problem.n_joints)
        rows = tuple(
            _triangle(np.column_stack([problem.matrix[:, j], problem.torque[:, j]]))
            for j in joints
        )
        return cls(tuple(problem.names), rows, len(problem.torque))

    @classmethod
    def joined(cls, parts: Iterable[JointTriangles]) -> JointTriangles:
        """Those of several problems of the same parameters together."""
        some = list(parts)
        of_joints = zip(*(part.rows for part in some), strict=True)
        rows = tuple(_triangle(np.vstack(own)) for own in of_joints)
        return cls(some[0].names, rows, sum(part.samples for part in some))

    @property
    def equations(self) -> int:
        """N n."""
        return self.samples * len(self.rows)

    def squares(self, beta: np.ndarray) -> np.ndarray:
        """|tau_j - W_j beta|^2 of each joint, (n,)."""
        z = np.append(-beta, 1.0)
        return np.array([float(np.sum((rows @ z) ** 2)) for rows in self.rows])

    def noise(self, beta: np.ndarray) -> np.ndarray:
        """As ``linear_estimator.joint_noise``, (n,)."""
        torque = max(float(np.abs(rows[:, -1]).max(initial=0.0)) for rows in self.rows)
        free = max(1.0 - len(beta) / self.equations, 1.0 / self.equations)
        noise = np.sqrt(self.squares(beta) / self.samples / free)
        return least_noise(noise, torque)

    def stacked(self, noise: np.ndarray | None = None) -> np.ndarray:
        """[R, z] of all joints one below the other, each divided by its noise, (n,), if that is given."""
        spread = np.ones(len(self.rows)) if noise is None else noise
        return np.vstack([x / s for x, s in zip(self.rows, spread, strict=True)])

    def factor(self, noise: np.ndarray | None = None) -> Factor:
        """The factor of all equations, each joint's divided by its noise, (n,)."""
        stacked = self.stacked(noise)
        factor = Factor.of(stacked[:, :-1], stacked[:, -1])
        return Factor(factor.triangle, factor.rotated, factor.rest, self.equations)


def _triangle(equations: np.ndarray) -> np.ndarray:
    """R of rows [W, tau]; half of a joint's columns are zero, as its torque has nothing of the bodies before it."""
    present = equations.any(axis=0)
    some = np.linalg.qr(equations[:, present], mode="r")
    out = np.zeros((len(some), equations.shape[1]))
    out[:, present] = some
    return out
