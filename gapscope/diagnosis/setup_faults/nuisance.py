"""What an arm may ordinarily have beyond its data sheet, fitted with every reading of its recordings.

The torque of joint j is taken as

    tau_j = (1 + k_j) p_j + Y_j delta + a_j ddq_j + c_j sgn dq_j + b_j dq_j + s_j q_j + o_j

with p the nominal arm's prediction, known payload included, Y the inertial regressor and delta errors of the inertials,
a load on the last link among them, common to all joints. All values have a wide normal prior around zero. What physics
forbids is forbidden: friction and rotor inertia in all not negative, the torque's scale not below 0.4. A wrong sign,
column or unit cannot be had by ordinary values then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import Samples
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    LEAST_TORQUE_DEVIATION,
    LOWEST_TORQUE_SCALE,
    ORDINARY_GAP_DEVIATION,
    ORDINARY_INERTIALS,
    ORDINARY_LEVER,
    ORDINARY_LOAD,
    ORDINARY_TORQUE_SCALE,
)

OWN = 6
"""Values of each joint of its own: scale, rotor, Coulomb, viscous, spring, offset."""


@dataclass(frozen=True)
class Equations:
    """Normal equations of each fold and joint under one reading of the motion, K folds, n joints.

    X_j = [Y_j units, p_j, ddq_j, sgn dq_j, dq_j, q_j, 1] has D = 10 n + 6 columns.

    Attributes:
        gram: X^T X, (K, n, D, D).
        cross: X^T tau for the torque of every column, (K, n, D, n).
        power: tau_i^2 summed, (K, n).
        rows: rows of each fold, (K,).
        deviation: standard deviation of each recorded torque column [N m], (n,).
        weight: independent samples per row.
        lowest: lower bounds of rotor [kg m^2], Coulomb [N m], viscous [N m s/rad] increments, (3, n).
        travel: range of each joint [rad], (n,).
        inertia: what a rotor's inertia is measured against [kg m^2], (n,).
    """

    gram: np.ndarray
    cross: np.ndarray
    power: np.ndarray
    rows: np.ndarray
    deviation: np.ndarray
    weight: float
    lowest: np.ndarray
    travel: np.ndarray
    inertia: np.ndarray


def inertial_units(body: RigidBody) -> tuple[np.ndarray, np.ndarray]:
    """Prior standard deviations of all inertial errors, (10 n,), in kg, kg m, kg m^2; and mean inertia per joint."""
    parameters = body.inertial_parameters().reshape(-1, 10)
    units = np.empty_like(parameters)
    for row, (m, hx, hy, hz, xx, _, yy, _, _, zz) in zip(
        units, parameters, strict=True
    ):
        moment = max(float(np.linalg.norm([hx, hy, hz])), 0.05 * m)
        row[:] = [m, *[moment] * 3, *[0.5 * (xx + yy + zz)] * 6]
    units *= ORDINARY_INERTIALS
    reach = sum(
        float(np.linalg.norm(body.model.jointPlacements[int(link)].translation))
        for link in body.links
    )
    mass = ORDINARY_LOAD * float(parameters[:, 0].sum())
    lever = ORDINARY_LEVER * max(reach, 0.1)
    load = np.array([mass, *[mass * lever] * 3, *[mass * lever**2] * 6])
    units[body.last_link] = np.hypot(units[body.last_link], load)
    inertia = np.diag(body.mass_matrix(np.zeros(body.n_joints)))
    return np.maximum(units.ravel(), 1e-9), np.asarray(inertia)


def equations(
    arm: NominalArm, body: RigidBody, samples: Samples, reading: ChannelMapping
) -> Equations:
    """Normal equations of all folds under a reading of the motion (its reading of the torque does not matter)."""
    q, dq, ddq = reading.motion(samples.q, samples.dq, samples.ddq)
    regressor = body.regressor(q, dq, ddq)
    sign = np.tanh(dq / FAULT_SIGN_WIDTH)
    nominal = (
        regressor @ body.inertial_parameters()
        + arm.armature * ddq
        + arm.coulomb * sign
        + arm.viscous * dq
    )
    if samples.load.any():
        last = regressor[:, :, 10 * body.last_link : 10 * body.last_link + 10]
        nominal += np.einsum("mjp,mp->mj", last, samples.load)
    units, inertia = inertial_units(body)
    own = np.stack(
        [nominal, ddq, sign, dq, q - q.mean(axis=0), np.ones_like(q)], axis=2
    )
    x = np.concatenate([regressor * units, own], axis=2).transpose(1, 0, 2)
    folds = samples.folds
    return Equations(
        gram=np.array([x[:, f].transpose(0, 2, 1) @ x[:, f] for f in folds]),
        cross=np.array([x[:, f].transpose(0, 2, 1) @ samples.tau[f] for f in folds]),
        power=np.array([(samples.tau[f] ** 2).sum(axis=0) for f in folds]),
        rows=np.array([f.stop - f.start for f in folds]),
        deviation=np.maximum(
            samples.tau.std(axis=0),
            max(LEAST_TORQUE_DEVIATION * float(samples.tau.std(axis=0).max()), 1e-9),
        ),
        weight=samples.weight,
        lowest=-np.array([arm.armature, arm.coulomb, arm.viscous]),
        travel=np.ptp(q, axis=0),
        inertia=np.maximum(
            np.maximum(inertia, arm.armature), 1e-3 * max(float(inertia.max()), 1e-3)
        ),
    )


def unseen(
    eq: Equations, reading: ChannelMapping, spread: float = 1.0
) -> tuple[np.ndarray, float]:
    """How well an ordinary arm explains the torque under a reading, and how extraordinary it has to be for that.

    Args:
        eq: normal equations under the motion of the reading.
        reading: its reading of the torque.
        spread: factor on the standard deviations of the prior.

    Returns:
        Gap left on each fold with values fitted to the other folds, over the torque's deviation, (K, n); and half the
        squared size of the values fitted to all folds, in deviations of their prior.
    """
    source, factor = list(reading.torque_source), np.array(reading.torque_factor)
    deviation = eq.deviation[source] * np.abs(factor)
    n, folds = len(source), len(eq.rows)
    shared = eq.gram.shape[2] - OWN
    cross = eq.cross[:, np.arange(n), :, source].transpose(1, 0, 2) * factor[:, None]
    target = cross - eq.gram[:, :, :, shared]  # of tau - p
    square = (
        eq.power[:, source] * factor**2
        - 2 * cross[:, :, shared]
        + eq.gram[:, :, shared, shared]
    )
    gap = np.empty((folds, n))
    for k in range(folds):
        kept = np.arange(folds) != k
        values = _fit(
            eq, eq.gram[kept].sum(axis=0), target[kept].sum(axis=0), deviation, spread
        )
        fitted = np.einsum("jd,jde,je->j", values, eq.gram[k], values)
        gap[k] = np.sqrt(
            np.clip(square[k] - 2 * (values * target[k]).sum(axis=1) + fitted, 0, None)
            / eq.rows[k]
        )
    values = _fit(eq, eq.gram.sum(axis=0), target.sum(axis=0), deviation, spread)
    own = values[:, shared:] / _spread(eq, deviation).T
    return gap / deviation, float(
        0.5 * (values[0, :shared] ** 2).sum() + 0.5 * (own**2).sum()
    ) / spread**2


def _fit(
    eq: Equations,
    gram: np.ndarray,
    target: np.ndarray,
    deviation: np.ndarray,
    spread: float,
) -> np.ndarray:
    """Most probable values of every joint's columns within their bounds, (n, D), from (n, D, D) and (n, D)."""
    n, columns = target.shape
    shared = columns - OWN
    precision = eq.weight / (ORDINARY_GAP_DEVIATION * deviation) ** 2
    size = shared + n * OWN
    prior = 1.0 / (spread * _spread(eq, deviation)) ** 2
    a, b = np.eye(size) / spread**2, np.zeros(size)
    for j in range(n):
        own = slice(shared + j * OWN, shared + (j + 1) * OWN)
        a[:shared, :shared] += precision[j] * gram[j, :shared, :shared]
        a[:shared, own] = precision[j] * gram[j, :shared, shared:]
        a[own, :shared] = a[:shared, own].T
        a[own, own] = precision[j] * gram[j, shared:, shared:] + np.diag(prior[:, j])
        b[:shared] += precision[j] * target[j, :shared]
        b[own] = precision[j] * target[j, shared:]
    lowest = np.full((n, OWN), -np.inf)
    lowest[:, 0] = LOWEST_TORQUE_SCALE
    lowest[:, 1:4] = eq.lowest.T
    solved = bounded(a, b, np.concatenate([np.full(shared, -np.inf), lowest.ravel()]))
    return np.hstack(
        [np.tile(solved[:shared], (n, 1)), solved[shared:].reshape(n, OWN)]
    )


def _spread(eq: Equations, deviation: np.ndarray) -> np.ndarray:
    """Prior standard deviations of a joint's own values, (6, n)."""
    n = len(deviation)
    speed = np.sqrt(eq.gram[:, :, -3, -3].sum(axis=0) / eq.rows.sum())
    return np.array(
        [
            np.full(n, ORDINARY_TORQUE_SCALE),
            eq.inertia,
            0.7 * deviation,
            0.7 * deviation / np.maximum(speed, 1e-3),
            0.5 * deviation / np.maximum(eq.travel, 1e-2),
            0.5 * deviation,
        ]
    )


def bounded(a: np.ndarray, b: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """Minimum of x^T A x / 2 - b^T x where x >= lowest, by fixing what falls below, at most five times; (P,)."""
    fixed = np.zeros(len(b), dtype=bool)
    x = np.zeros(len(b))
    for _ in range(5):
        x[fixed] = lowest[fixed]
        free = ~fixed
        x[free] = np.linalg.solve(
            a[np.ix_(free, free)], b[free] - a[np.ix_(free, fixed)] @ x[fixed]
        )
        below = x < lowest - 1e-12
        if not below.any():
            break
        fixed |= below
    return np.maximum(x, lowest)
