"""Which rows each member of an ensemble is fitted to and which it holds out, and how good it is on these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

QUIET = 0.1
"""A recording weighs as if its RMS were at least this share of the loudest one's."""
LEAST_GAIN = 0.02
"""A form that closes less than this share of the squares held out of a joint, less its error, gets no say there."""
MOST_LOSS = 0.02
"""A form may add no more than this share to the squares of a joint in any group that it did not see."""
GAINS = np.linspace(0.05, 1.0, 20)
"""Factors tried on a joint's output."""


@dataclass(frozen=True)
class Folds:
    """Rows and targets of M members (the first axis), N rows of n joints.

    What counts is the share of its own squares that is left of each group: a group with a large residual would
    otherwise outvote those in which the same function does harm.

    Attributes:
        group: of each row, (N,); -1 is neither fitted nor held out.
        held: rows that each member holds out, (M, N).
        targets: residual without what the physics explains of it in the rows that the member is fitted to, over its
            scale [1], (M, N, n).
        weight: one over the RMS of the row's group, per joint, (N, n); (N,) of one joint.
    """

    group: np.ndarray
    held: np.ndarray
    targets: np.ndarray
    weight: np.ndarray

    @property
    def any_fitted(self) -> np.ndarray:
        """Rows that some member is fitted to, (N,)."""
        return self.group >= 0

    @property
    def fitted(self) -> np.ndarray:
        """Rows that each member is fitted to, (M, N)."""
        return self.any_fitted & ~self.held

    def of_joint(self, joint: int) -> Folds:
        """The same of one joint."""
        targets = self.targets[:, :, [joint]]
        return replace(self, targets=targets, weight=self.weight[:, joint])

    def held_out(self, outputs: np.ndarray) -> np.ndarray:
        """Each row as the members that held it out predict it, from the outputs of all, (M, N, ...); (N, ...)."""
        held = self.held.reshape(*self.held.shape, *[1] * (outputs.ndim - 2))
        total = np.maximum(held.sum(axis=0), 1)
        return np.asarray((outputs * held).sum(axis=0) / total)

    def error(
        self, residual: np.ndarray, outputs: np.ndarray, weight: np.ndarray
    ) -> float:
        """Weighted mean square of what is left of a joint's residual, (N,), on rows held out."""
        left = weight * (residual - self.held_out(outputs))
        return float((left[self.held.any(axis=0)] ** 2).mean())


def make_folds(
    group: np.ndarray, members: int, residual: np.ndarray, q: np.ndarray
) -> Folds:
    """Folds by group.

    Args:
        group: of each row, (N,).
        members: in the ensemble; member m holds out the groups m, m + members, ...
        residual: over its scale [1], (N, n).
        q: orthonormal columns of the physics, (N, n, r).
    """
    held = np.stack([(group % members == m) & (group >= 0) for m in range(members)])
    held = held[held.any(axis=1)]
    targets = [
        residual - q @ _explaining(q[rows], residual[rows])
        for rows in (group >= 0) & ~held
    ]
    return Folds(group, held, np.stack(targets), group_weights(residual, group))


def _explaining(q: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Coefficients of the columns that explain a residual best on some rows, (r,)."""
    gram = np.einsum("mnr,mns->rs", q, q)
    moment = np.einsum("mnr,mn->r", q, residual)
    return np.asarray(np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ moment)


def group_weights(residual: np.ndarray, group: np.ndarray) -> np.ndarray:
    """One over the RMS of each row's group, per joint, over its RMS over all rows, (N, n)."""
    weight = np.zeros_like(residual)
    groups = np.unique(group)
    square = np.stack([(residual[group == g] ** 2).mean(axis=0) for g in groups])
    square = np.maximum(square, QUIET**2 * square.max(axis=0))
    for g, of_group in zip(groups, square, strict=True):
        weight[group == g] = 1.0 / np.sqrt(np.maximum(of_group, 1e-300))
    return np.asarray(weight / np.sqrt((weight**2).mean(axis=0)))


def shares_closed(
    folds: Folds, residual: np.ndarray, predicted: np.ndarray
) -> np.ndarray:
    """Share of each group's squares that a prediction closes at each factor of ``GAINS``, (groups, n, factors).

    Args:
        folds: the groups.
        residual: over its scale [1], (N, n).
        predicted: by the members that held each row out, (N, n).
    """
    shares = []
    for g in np.unique(folds.group[folds.any_fitted]):
        y, f = residual[folds.group == g], predicted[folds.group == g]
        size = np.maximum((y**2).sum(axis=0), 1e-300)
        agreement, square = (y * f).sum(axis=0) / size, (f**2).sum(axis=0) / size
        shares.append(np.outer(agreement, 2 * GAINS) - np.outer(square, GAINS**2))
    return np.stack(shares)


def usefulness(
    shares: np.ndarray, strict: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the squares closed on rows held out, mean over the groups, and the factor for it; each (n,).

    The factor on a joint's output is the one of ``GAINS`` with the largest share, less its standard error over the
    groups, at which no group is left with more than ``MOST_LOSS`` above its squares. It is 0 if that share less its
    error is below ``LEAST_GAIN``.

    Args:
        shares: of each group, at each factor, see ``shares_closed``.
        strict: every group by itself must close ``LEAST_GAIN`` after that error is taken off: a motion that is in none
            of the groups is then likely to gain as well.
    """
    worst, mean = shares.min(axis=0), shares.mean(axis=0)
    error = shares.std(axis=0, ddof=1) / np.sqrt(len(shares))
    harmless = worst - error >= LEAST_GAIN if strict else worst >= -MOST_LOSS
    certain = np.where(harmless, mean - error, 0.0)
    best = certain.argmax(axis=1)
    joints = np.arange(len(best))
    of_use = certain[joints, best] >= LEAST_GAIN
    return (
        np.where(of_use, mean[joints, best], 0.0),
        np.where(of_use, GAINS[best], 0.0),
    )
