"""The ordinary values of an arm fitted under a reading: the gap on held-out folds, and the penalty on the values."""

from __future__ import annotations

import numpy as np

from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.arm_weight import weight_penalty
from gapscope.diagnosis.setup_faults.nuisance import (
    OWN,
    ROTOR,
    VISCOUS,
    FoldEquations,
    ReadTorque,
)
from gapscope.diagnosis.thresholds import (
    LOWEST_TORQUE_SCALE,
    ORDINARY_FRICTION,
    ORDINARY_GAP_DEVIATION,
    ORDINARY_OFFSET,
    ORDINARY_ROTOR,
    ORDINARY_SPRING,
    ORDINARY_TORQUE_SCALE,
)

MOST_ROUNDS = 5
"""Times at most that values below their bounds are fixed there."""


def held_out_gap(
    eq: FoldEquations, reading: Reading, spread: float = 1.0
) -> tuple[np.ndarray, float]:
    """How well an ordinary arm explains the torque under a reading, and how extraordinary it must be for that.

    Args:
        eq: normal equations under the motion of the reading.
        reading: how to read the torque.
        spread: factor on the standard deviations of the prior.

    Returns:
        Gap left on each fold with values fitted to the other folds, over the torque's deviation, (K, n); and half the
        squared size of the values fitted to all folds, in deviations of their prior.
    """
    torque = eq.read(reading)
    target, square = _against_nominal(eq, torque)
    # cross-validation over the folds; the last fit is to all of them
    folds = len(eq.rows)
    others = np.vstack([1.0 - np.eye(folds), np.ones(folds)])
    values = _fit(eq, target, torque.deviation, spread, others)
    gap = _gap(eq, target, square, values[:folds]) / torque.deviation
    return gap, _penalty(eq, torque, values[folds], spread)


def fitted_gap(eq: FoldEquations, reading: Reading) -> tuple[np.ndarray, float]:
    """The same with the gap on each fold of the values fitted to all folds: smaller, at a fraction of the cost."""
    torque = eq.read(reading)
    target, square = _against_nominal(eq, torque)
    whole = np.ones((1, len(eq.rows)))
    values = _fit(eq, target, torque.deviation, 1.0, whole)
    gap = _gap(eq, target, square, values) / torque.deviation
    return gap, _penalty(eq, torque, values[0], 1.0)


def _gap(
    eq: FoldEquations, target: np.ndarray, square: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """RMS of what values, (K, n, D) or (1, n, D) for all, leave on each fold [N m], (K, n)."""
    explained = 2 * (values * target).sum(axis=2)
    fitted_square = (values * (eq.gram @ values[..., None])[..., 0]).sum(axis=2)
    squared_error = np.clip(square - explained + fitted_square, 0, None)
    return np.asarray(np.sqrt(squared_error / eq.rows[:, None]))


def _penalty(
    eq: FoldEquations, torque: ReadTorque, values: np.ndarray, spread: float
) -> float:
    """Half the squared size of values, (n, D), and of the arm's weight, in deviations of their prior."""
    inertial = values[0, : eq.shared]
    own = values[:, eq.shared :] / _own_prior_std(eq, torque.deviation)
    penalty = 0.5 * float((inertial**2).sum() + (own**2).sum()) / spread**2
    return penalty + weight_penalty(eq, torque, spread)


def _against_nominal(
    eq: FoldEquations, torque: ReadTorque
) -> tuple[np.ndarray, np.ndarray]:
    """X_j^T (tau_j - f_j), (K, n, D), and the sum of (tau_j - f_j)^2, (K, n).

    f is the nominal arm's torque, friction included.
    """
    nominal = eq.nominal
    predicted = np.einsum("kjde,je->kjd", eq.gram, nominal)
    square = (
        torque.square
        - 2 * np.einsum("kjd,jd->kj", torque.cross, nominal)
        + np.einsum("kjd,jd->kj", predicted, nominal)
    )
    return torque.cross - predicted, square


def _fit(
    eq: FoldEquations,
    target: np.ndarray,
    deviation: np.ndarray,
    spread: float,
    weights: np.ndarray,
) -> np.ndarray:
    """Most probable values of every joint's columns within their bounds, (F, n, D), of several fits at once.

    The unknowns are the inertial errors, once, and then the own values of each joint.

    Args:
        eq: normal equations of K folds.
        target: right sides, (K, n, D).
        deviation: of each joint's torque [N m], (n,).
        spread: factor on the standard deviations of the prior.
        weights: of the folds in each fit, (F, K).
    """
    n, shared, fits = target.shape[1], eq.shared, len(weights)
    precision = eq.weight / (ORDINARY_GAP_DEVIATION * deviation) ** 2
    gram = np.tensordot(weights, eq.gram, 1) * precision[:, None, None]
    right = np.tensordot(weights, target, 1) * precision[:, None]
    own_precision = 1.0 / (spread * _own_prior_std(eq, deviation)) ** 2

    # all joints share the inertial errors; their own values meet only through these
    size = shared + n * OWN
    matrix = np.zeros((fits, size, size))
    matrix[:, :shared, :shared] = gram[:, :, :shared, :shared].sum(axis=1)
    matrix[:, :shared, :shared] += np.eye(shared) / spread**2
    for j in range(n):
        own = slice(shared + j * OWN, shared + (j + 1) * OWN)
        coupling = gram[:, j, :shared, shared:]
        matrix[:, :shared, own] = coupling
        matrix[:, own, :shared] = coupling.transpose(0, 2, 1)
        matrix[:, own, own] = gram[:, j, shared:, shared:] + np.diag(own_precision[j])
    inertial_side = right[:, :, :shared].sum(axis=1)
    own_side = right[:, :, shared:].reshape(fits, -1)
    solved = bounded_minimum(matrix, np.hstack([inertial_side, own_side]), _lowest(eq))
    inertial = np.repeat(solved[:, None, :shared], n, axis=1)
    return np.concatenate([inertial, solved[:, shared:].reshape(fits, n, OWN)], axis=2)


def _lowest(eq: FoldEquations) -> np.ndarray:
    """Lower bounds of the unknowns: the inertial errors, then each joint's own values."""
    n = eq.gram.shape[1]
    # scale, rotor, Coulomb and viscous friction have lower bounds; spring and offset have none
    own = np.full((n, OWN), -np.inf)
    own[:, 0] = LOWEST_TORQUE_SCALE
    own[:, 1:4] = eq.lowest.T
    # and no link weighs less than nothing
    shared = np.full(eq.shared, -np.inf)
    shared[: 10 * n : 10] = eq.lowest_mass
    return np.concatenate([shared, own.ravel()])


def _own_prior_std(eq: FoldEquations, deviation: np.ndarray) -> np.ndarray:
    """Prior standard deviations of each joint's own values, (n, 6)."""
    speed, acceleration = (
        np.sqrt(eq.gram[:, :, column, column].sum(axis=0) / eq.rows.sum())
        for column in (eq.shared + VISCOUS, eq.shared + ROTOR)
    )
    coulomb, viscous = -eq.lowest[1:]
    # behind a high gear a rotor takes most of the torque, however light the links are
    rotor = ORDINARY_ROTOR * deviation / np.maximum(acceleration, 1e-3)
    return np.column_stack(
        [
            np.full(len(deviation), ORDINARY_TORQUE_SCALE),
            np.hypot(rotor, eq.inertia),
            # nominal friction may be a placeholder: an arm without any of it is ordinary
            np.hypot(ORDINARY_FRICTION * deviation, coulomb),
            np.hypot(ORDINARY_FRICTION * deviation / np.maximum(speed, 1e-3), viscous),
            ORDINARY_SPRING * deviation / np.maximum(eq.travel, 1e-2),
            ORDINARY_OFFSET * deviation,
        ]
    )


def bounded_minimum(a: np.ndarray, b: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """Minima of x^T A x / 2 - b^T x for x >= lowest, by fixing what falls below, at most ``MOST_ROUNDS`` times; (F, P).

    A value that was fixed is not freed again, so that the result may lie beside the exact optimum
    (``scipy.optimize.lsq_linear``): it is eight times as fast and called some hundred times per case.

    Args:
        a: A of each problem, (F, P, P).
        b: of each problem, (F, P).
        lowest: of all, (P,).
    """
    fixed = np.zeros(b.shape, dtype=bool)
    bound = np.where(np.isfinite(lowest), lowest, 0.0)
    diagonal = np.arange(b.shape[1])
    for _ in range(MOST_ROUNDS):
        held = fixed * bound
        right_side = b - (a @ held[..., None])[..., 0]
        # the equation of a value that is fixed says so
        reduced = np.where(fixed[:, :, None] | fixed[:, None, :], 0.0, a)
        reduced[:, diagonal, diagonal] += fixed
        free = np.linalg.solve(reduced, np.where(fixed, 0.0, right_side)[..., None])
        x = held + free[..., 0]
        below = x < lowest - 1e-12
        if not below.any():
            break
        fixed |= below
    return np.maximum(x, lowest)
