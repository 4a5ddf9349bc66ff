"""The ordinary values of an arm fitted under a mapping: the gap on held-out folds, and the penalty on the values."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from gapscope.diagnosis.setup_faults.arm_weight import weight_penalty
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.nuisance import (
    OWN,
    VISCOUS,
    FoldEquations,
    ReadTorque,
)
from gapscope.diagnosis.thresholds import (
    LOWEST_TORQUE_SCALE,
    ORDINARY_FRICTION,
    ORDINARY_GAP_DEVIATION,
    ORDINARY_OFFSET,
    ORDINARY_SPRING,
    ORDINARY_TORQUE_SCALE,
)

MOST_ROUNDS = 5
"""Times at most that values below their bounds are fixed there."""


def held_out_gap(
    eq: FoldEquations, mapping: ChannelMapping, spread: float = 1.0
) -> tuple[np.ndarray, float]:
    """How well an ordinary arm explains the torque under a mapping, and how extraordinary it must be for that.

    Args:
        eq: normal equations under the motion of the mapping.
        mapping: how to read the torque.
        spread: factor on the standard deviations of the prior.

    Returns:
        Gap left on each fold with values fitted to the other folds, over the torque's deviation, (K, n); and half the
        squared size of the values fitted to all folds, in deviations of their prior.
    """
    torque = eq.read(mapping)
    target, square = _against_nominal(eq, torque)
    # cross-validation over the folds
    folds = np.arange(len(eq.rows))
    left_out = [
        _fit(
            eq,
            eq.gram[folds != k].sum(axis=0),
            target[folds != k].sum(axis=0),
            torque.deviation,
            spread,
        )
        for k in folds
    ]
    gap = _gap(eq, target, square, np.array(left_out)) / torque.deviation
    values = _fit(eq, eq.gram.sum(axis=0), target.sum(axis=0), torque.deviation, spread)
    return gap, _penalty(eq, torque, values, spread)


def fitted_gap(eq: FoldEquations, mapping: ChannelMapping) -> tuple[np.ndarray, float]:
    """The same with the gap on each fold of the values fitted to all folds: smaller, at a fraction of the cost."""
    torque = eq.read(mapping)
    target, square = _against_nominal(eq, torque)
    values = _fit(eq, eq.gram.sum(axis=0), target.sum(axis=0), torque.deviation, 1.0)
    on_each = np.broadcast_to(values, (len(eq.rows), *values.shape))
    gap = _gap(eq, target, square, on_each) / torque.deviation
    return gap, _penalty(eq, torque, values, 1.0)


def _gap(
    eq: FoldEquations, target: np.ndarray, square: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """RMS of what values, (K, n, D), leave on each fold [N m], (K, n)."""
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
    gram: np.ndarray,
    target: np.ndarray,
    deviation: np.ndarray,
    spread: float,
) -> np.ndarray:
    """Most probable values of every joint's columns within their bounds, (n, D), from (n, D, D) and (n, D).

    The unknowns are the inertial errors, once, and then the own values of each joint.
    """
    n, shared = len(target), eq.shared
    precision = eq.weight / (ORDINARY_GAP_DEVIATION * deviation) ** 2
    weighted_gram = precision[:, None, None] * gram
    weighted_target = precision[:, None] * target
    own_precision = 1.0 / (spread * _own_prior_std(eq, deviation)) ** 2

    # all joints share the inertial errors; their own values meet only through these
    inertial_block = weighted_gram[:, :shared, :shared].sum(axis=0)
    inertial_block += np.eye(shared) / spread**2
    coupling = np.hstack(list(weighted_gram[:, :shared, shared:]))
    own_block = block_diag(*weighted_gram[:, shared:, shared:])
    own_block += np.diag(own_precision.ravel())
    matrix = np.block([[inertial_block, coupling], [coupling.T, own_block]])
    inertial_side = weighted_target[:, :shared].sum(axis=0)
    right_side = np.concatenate([inertial_side, weighted_target[:, shared:].ravel()])

    # scale, rotor, Coulomb and viscous friction have lower bounds; spring and offset have none
    own_lowest = np.full((n, OWN), -np.inf)
    own_lowest[:, 0] = LOWEST_TORQUE_SCALE
    own_lowest[:, 1:4] = eq.lowest.T
    # and no link weighs less than nothing
    shared_lowest = np.full(shared, -np.inf)
    shared_lowest[: 10 * n : 10] = eq.lowest_mass
    lowest = np.concatenate([shared_lowest, own_lowest.ravel()])
    solved = bounded_minimum(matrix, right_side, lowest)
    own = solved[shared:].reshape(n, OWN)
    return np.hstack([np.tile(solved[:shared], (n, 1)), own])


def _own_prior_std(eq: FoldEquations, deviation: np.ndarray) -> np.ndarray:
    """Prior standard deviations of each joint's own values, (n, 6)."""
    speed_square = eq.gram[:, :, eq.shared + VISCOUS, eq.shared + VISCOUS]
    speed = np.sqrt(speed_square.sum(axis=0) / eq.rows.sum())
    coulomb, viscous = -eq.lowest[1:]
    return np.column_stack(
        [
            np.full(len(deviation), ORDINARY_TORQUE_SCALE),
            eq.inertia,
            # nominal friction may be a placeholder: an arm without any of it is ordinary
            np.hypot(ORDINARY_FRICTION * deviation, coulomb),
            np.hypot(ORDINARY_FRICTION * deviation / np.maximum(speed, 1e-3), viscous),
            ORDINARY_SPRING * deviation / np.maximum(eq.travel, 1e-2),
            ORDINARY_OFFSET * deviation,
        ]
    )


def bounded_minimum(a: np.ndarray, b: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """Minimum of x^T A x / 2 - b^T x for x >= lowest, by fixing what falls below, at most ``MOST_ROUNDS`` times; (P,).

    A value that was fixed is not freed again, so that the result may lie beside the exact optimum
    (``scipy.optimize.lsq_linear``): it is eight times as fast and called some hundred times per case.
    """
    fixed = np.zeros(len(b), dtype=bool)
    x = np.zeros(len(b))
    for _ in range(MOST_ROUNDS):
        free = ~fixed
        x[fixed] = lowest[fixed]
        right_side = b[free] - a[np.ix_(free, fixed)] @ x[fixed]
        x[free] = np.linalg.solve(a[np.ix_(free, free)], right_side)
        below = x < lowest - 1e-12
        if not below.any():
            break
        fixed |= below
    return np.maximum(x, lowest)
