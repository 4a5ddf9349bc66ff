"""Keeping a network and the physics apart: projections on the columns of the physics, in weighted torque."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from gapscope.ident.signals.effective_samples import variance_inflation

DEPENDENT = 1e-7
"""Singular value of unit columns, over the largest, below which a direction counts as none."""


def basis(columns: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Orthonormal basis Q of the columns, (M, n, p), each joint's rows divided by its scale [N m]; (M, n, r)."""
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


def project_heads(
    hidden: np.ndarray, head: np.ndarray, q: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Weights of linear heads, changed as little as can be, whose output is orthogonal to the columns.

    With f = Phi w the output over all rows, minimises |Phi dw|^2 + eps |dw|^2 subject to Q^T Phi (w + dw) = 0: one
    constraint per direction of the physics, against (hidden + 1) weights per joint. If there are fewer weights than
    constraints, the constraints hold as nearly as possible (least squares).

    Args:
        hidden: what the heads see and a 1 beside it, (n, M, hidden + 1).
        head: their weights, (n, hidden + 1).
        q: orthonormal columns in weighted torque, (M, n, r).
        active: joints whose head may change, (n,); the others' weights must be 0.

    Returns:
        The weights, (n, hidden + 1).
    """
    joints = np.flatnonzero(active)
    if not len(joints):
        return head
    width = head.shape[1]
    constraint = np.concatenate([q[:, j].T @ hidden[j] for j in joints], axis=1)
    metric = block_diag(*(hidden[j].T @ hidden[j] for j in joints))
    # regular even if hidden units saturate
    metric += 1e-6 * np.trace(metric) / len(metric) * np.eye(len(metric))
    root = np.linalg.cholesky(metric)
    # in z = L^T dw the least change is the solution of least norm
    weights = head[active].ravel()
    turned = np.linalg.solve(root, constraint.T).T
    z = np.linalg.lstsq(turned, -constraint @ weights, rcond=1e-12)[0]
    projected = head.copy()
    change = np.linalg.solve(root.T, z)
    projected[active] = (weights + change).reshape(-1, width)
    return projected


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
