"""A linear model with columns that act in some stretches alone, fitted to normal equations by stretch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gapscope.diagnosis.agreement.equations import Equations

TOLERANCE = 1e-10
"""Eigenvalues below this share of the largest belong to no direction of the model [1]."""


@dataclass(frozen=True)
class Scores:
    """What changes along d directions, each in every stretch apart, would bring: Z beside the columns X.

    s^T V^-1 s is what the sum of weighted squares falls by if the changes join the model.

    Attributes:
        score: s = Z^T (y - X gamma), (K, d).
        information: V = Z^T Z - Z^T X (X^T X)^-1 X^T Z, (K, d, K, d).
        unit: of the changes, in which the stretches together have Z^T Z = 1 along each direction, (d,).
    """

    score: np.ndarray
    information: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class StretchModel:
    """Columns x_q, each a change of the base parameters in every stretch and on every joint.

    Attributes:
        of: the equations.
        columns: (q, K, n, b).
        owners: what each column belongs to: ``""`` for the base parameters of all recordings, else a hypothesis' key.
        images: Gram matrix of each stretch and joint times the columns, (q, K, n, b).
        normal: X^T X, (q, q).
        right: X^T y, (q,).
    """

    of: Equations
    columns: np.ndarray
    owners: tuple[str, ...]
    images: np.ndarray
    normal: np.ndarray
    right: np.ndarray

    @classmethod
    def make(
        cls, of: Equations, columns: np.ndarray, owners: tuple[str, ...]
    ) -> StretchModel:
        """The model of these columns."""
        images = np.einsum("kjab,qkjb->qkja", of.gram, columns, optimize=True)
        q = len(columns)
        flat = columns.reshape(q, -1)
        return cls(
            of,
            columns,
            owners,
            images,
            flat @ images.reshape(q, -1).T,
            flat @ of.right.ravel(),
        )

    @classmethod
    def shared(cls, of: Equations) -> StretchModel:
        """Base parameters that all recordings share."""
        b, (k, n) = of.base.count, of.gram.shape[:2]
        columns = np.broadcast_to(np.eye(b)[:, None, None, :], (b, k, n, b))
        return cls.make(of, np.ascontiguousarray(columns), ("",) * b)

    def extended(self, columns: np.ndarray, owner: str) -> StretchModel:
        """The model with further columns, (q', K, n, b)."""
        every = np.concatenate([self.columns, columns])
        return StretchModel.make(
            self.of, every, (*self.owners, *[owner] * len(columns))
        )

    def without(self, owner: str, base: int | None = None) -> StretchModel:
        """The model without the columns of an owner, and without one base parameter."""
        kept = [
            q
            for q, name in enumerate(self.owners)
            if (name != owner or not name) and q != base
        ]
        return StretchModel(
            self.of,
            self.columns[kept],
            tuple(self.owners[q] for q in kept),
            self.images[kept],
            self.normal[np.ix_(kept, kept)],
            self.right[kept],
        )

    @cached_property
    def fitted(self) -> tuple[np.ndarray, np.ndarray]:
        """Inverse of X^T X on the directions that are determined, (q, q), and the base parameters, (K, n, b)."""
        unit = 1.0 / np.sqrt(np.maximum(np.diag(self.normal), 1e-300))
        inverse = np.linalg.pinv(
            self.normal * unit[:, None] * unit, rcond=TOLERANCE, hermitian=True
        )
        inverse = inverse * unit[:, None] * unit
        return inverse, np.tensordot(inverse @ self.right, self.columns, axes=1)

    def scores(self, directions: np.ndarray) -> Scores:
        """Score and information of a change along d directions, (d, n, b), in every stretch apart."""
        inverse, fitted = self.fitted
        gram = self.of.gram
        explained = np.einsum("kjab,kjb->kja", gram, fitted, optimize=True)
        score = np.einsum("dja,kja->kd", directions, self.of.right - explained)
        own = np.einsum(
            "dja,kjab,ejb->kde", directions, gram, directions, optimize=True
        )
        power = np.einsum("kdd->d", own)
        unit = 1.0 / np.sqrt(np.where(power > 0.0, power, 1.0))
        cross = np.einsum("dja,qkja->kdq", directions, self.images, optimize=True)
        cross = cross * unit[:, None]
        information = -np.einsum(
            "kdq,qp,lep->kdle", cross, inverse, cross, optimize=True
        )
        stretches = np.arange(len(own))
        information[stretches, :, stretches, :] += own * unit[:, None] * unit
        return Scores(score * unit, information, unit)
