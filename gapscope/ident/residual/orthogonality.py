"""Keeping a network and the physics apart: projections on the columns of the physics, in weighted torque."""

from __future__ import annotations

import numpy as np

from gapscope.ident.signals.effective_samples import variance_inflation

DEPENDENT = 1e-7
"""Singular value of unit columns, over the largest, below which a direction counts as none."""


def basis(columns: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Orthonormal basis Q of the columns, (M, n, p), each joint's rows divided by its scale [N m]; (M, n, r)."""
    stacked = (columns / scale[None, :, None]).reshape(-1, columns.shape[2])
    norms = np.linalg.norm(stacked, axis=0)
    u, size, _ = np.linalg.svd(
        stacked[:, norms > 0] / norms[norms > 0], full_matrices=False
    )
    kept = u[:, size > DEPENDENT * size[0]] if size.size else u
    return kept.reshape(*columns.shape[:2], -1)


def left_by(q: np.ndarray, torque: np.ndarray) -> np.ndarray:
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
    n, width = head.shape
    constraint = np.concatenate(
        [q[:, j].T @ hidden[j] for j in range(n) if active[j]] or [np.zeros((0, 0))],
        axis=1,
    )
    if not active.any():
        return head
    grams = [hidden[j].T @ hidden[j] for j in range(n) if active[j]]
    metric = np.zeros((width * len(grams), width * len(grams)))
    for k, gram in enumerate(grams):
        metric[k * width : (k + 1) * width, k * width : (k + 1) * width] = gram
    metric += 1e-6 * np.trace(metric) / len(metric) * np.eye(len(metric))
    root = np.linalg.cholesky(metric)
    # in z = L^T dw the least change is the solution of least norm
    weights = head[active].ravel()
    z = np.linalg.lstsq(
        np.linalg.solve(root, constraint.T).T, -constraint @ weights, rcond=1e-12
    )[0]
    out = head.copy()
    out[active] = (weights + np.linalg.solve(root.T, z)).reshape(-1, width)
    return out


def parameter_moves(
    columns: np.ndarray, torque: np.ndarray, left: np.ndarray, group: np.ndarray
) -> np.ndarray:
    """By how many standard deviations parameters would move if refitted with a torque in place; shape (k,).

    The move is (T^T T)^+ T^T f, its standard deviation that of a fit to the data, the noise counted by its
    autocorrelation.

    Args:
        columns: T of the parameters, in weighted torque, (M, n, k).
        torque: f in weighted torque, (M, n).
        left: the residual of the data without f, in weighted torque, (M, n).
        group: trajectory of each row, (M,).
    """
    if columns.shape[2] == 0:
        return np.zeros(0)
    stacked = columns.reshape(-1, columns.shape[2])
    norms = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    unit = stacked / norms
    gram = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    noise = (left**2).mean(axis=0) * variance_inflation(left, group)
    spread = np.einsum(
        "mnk,mnl,n->kl", unit.reshape(columns.shape), unit.reshape(columns.shape), noise
    )
    deviation = np.sqrt(np.clip(np.diag(gram @ spread @ gram), 1e-300, None))
    return np.asarray(np.abs(gram @ (unit.T @ torque.ravel())) / deviation)
