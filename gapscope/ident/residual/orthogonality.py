"""Keeping a network and the physics apart: projections on the columns of the physics, in weighted torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.model.effective_samples import variance_inflation

DEPENDENT = 1e-7
"""Singular value of unit columns, over the largest, below which a direction counts as none."""


def basis(columns: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Orthonormal basis Q of the columns, (M, n, p), each joint's rows divided by its scale [N m]; (M, n, r)."""
    if not columns.any():
        return np.zeros((*columns.shape[:2], 0))
    stacked = (columns / scale[None, :, None]).reshape(-1, columns.shape[2])
    norms = np.linalg.norm(stacked, axis=0)
    unit = stacked[:, norms > 0] / norms[norms > 0]
    u, size, _ = np.linalg.svd(unit, full_matrices=False)
    if size.size:
        u = u[:, size > DEPENDENT * size[0]]
    return u.reshape(*columns.shape[:2], -1)


def unexplained_by(q: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """What the columns do not explain of a weighted torque (M, n): y - Q Q^T y."""
    return np.asarray(torque - q @ np.einsum("mnr,mn->r", q, torque))


def share_explained(q: np.ndarray, torque: np.ndarray) -> float:
    """Share of the squares of a weighted torque, (M, n), that lies in the span of the columns."""
    return float(
        (np.einsum("mnr,mn->r", q, torque) ** 2).sum()
        / max(float((torque**2).sum()), 1e-300)
    )


@dataclass(frozen=True)
class Head:
    """How the linear head of a joint, f = Phi w over M rows, can change; r directions of the physics.

    Attributes:
        root: L of the metric L L^T = Phi^T Phi + diag(penalty) of a change, (K, K).
        inside: Q^T Phi, the part of the output in the physics, (r, K).
        turned: L^-1 (Q^T Phi)^T, (K, r).
    """

    root: np.ndarray
    inside: np.ndarray
    turned: np.ndarray


def head_of(seen: np.ndarray, penalty: np.ndarray, q: np.ndarray) -> Head:
    """A joint's head.

    Args:
        seen: Phi, what it sees, (M, K).
        penalty: how much a change of each weight costs beside the change of the output, (K,).
        q: the joint's rows of the orthonormal columns in weighted torque, (M, r).
    """
    metric = seen.T @ seen + np.diag(penalty)
    # regular even if hidden units saturate
    metric += 1e-9 * np.trace(metric) / len(metric) * np.eye(len(metric))
    root = np.linalg.cholesky(metric)
    inside = q.T @ seen
    return Head(root, inside, solve_triangular(root, inside.T, lower=True))


def project_heads(
    heads: dict[int, Head], weights: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Weights of linear heads, changed as little as can be, whose output is orthogonal to the columns.

    Minimises the sum over joints of |Phi dw|^2 + dw^T diag(penalty) dw subject to Q^T Phi (w + dw) = 0: one constraint
    per direction of the physics. If there are fewer weights than constraints, the constraints hold as nearly as
    possible (least squares).

    Args:
        heads: by joint, from 0.
        weights: of the joints that speak, w, each (K,).

    Returns:
        The weights by joint, each (K,).
    """
    if not weights:
        return {}
    turned = np.concatenate([heads[joint].turned for joint in weights])
    inside = sum(heads[joint].inside @ w for joint, w in weights.items())
    # in z = L^T dw the least change is the solution of least norm
    z = np.linalg.lstsq(turned.T, -np.asarray(inside), rcond=1e-12)[0]
    found, start = {}, 0
    for joint, w in weights.items():
        part = z[start : start + len(w)]
        start += len(part)
        change = solve_triangular(heads[joint].root, part, lower=True, trans="T")
        found[joint] = w + change
    return found


def parameter_moves(
    columns: np.ndarray, torque: np.ndarray, residual: np.ndarray, group: np.ndarray
) -> np.ndarray:
    """By how many standard deviations parameters would move if refitted with a torque in place; shape (k,).

    The move is (T^T T)^+ T^T f, its standard deviation that of a fit to the data, the noise counted by its
    autocorrelation.

    Args:
        columns: T of the parameters, in weighted torque, (M, n, k).
        torque: f in weighted torque, (M, n).
        residual: of the data without f, in weighted torque, (M, n).
        group: trajectory of each row, (M,).
    """
    if columns.shape[2] == 0:
        return np.zeros(0)
    stacked = columns.reshape(-1, columns.shape[2])
    norms = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    unit = stacked / norms
    gram = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    noise = (residual**2).mean(axis=0) * variance_inflation(residual, group)
    by_joint = unit.reshape(columns.shape)
    spread = np.einsum("mnk,mnl,n->kl", by_joint, by_joint, noise)
    variance = np.diag(gram @ spread @ gram)
    move = gram @ (unit.T @ torque.ravel())
    return np.asarray(np.abs(move) / np.sqrt(np.clip(variance, 1e-300, None)))
