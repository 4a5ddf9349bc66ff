"""What an arm may ordinarily have beyond its data sheet, fitted under every mapping of its recordings.

The torque of joint j is taken as

    tau_j = (1 + k_j) p_j + Y_j delta + a_j ddq_j + (c0_j + c_j) sgn dq_j + (b0_j + b_j) dq_j + s_j q_j + o_j

with p the torque that the nominal arm's bodies and rotors need, known payload included, c0 and b0 its friction, Y the
inertial regressor and delta errors of the inertials, a load on the last link among them, common to all joints. All
values have a wide normal prior around zero; that of friction is at least as wide as the nominal friction, which is
often a placeholder and may be gone. What physics forbids is forbidden: friction and rotor inertia in all not negative,
the torque's scale not below 0.4. A wrong sign, column or unit cannot be had by ordinary values then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import FaultSamples
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    LEAST_TORQUE_DEVIATION,
    ORDINARY_INERTIALS,
    ORDINARY_LEVER,
    ORDINARY_LOAD,
    ORDINARY_TILT,
)

OWN = 6
"""Values of each joint of its own: scale, rotor, Coulomb, viscous, spring, offset."""
COULOMB, VISCOUS = 2, 3
"""Places of the friction coefficients among them."""


@dataclass(frozen=True)
class FoldEquations:
    """Normal equations of each fold and joint under one mapping of the motion, K folds, n joints.

    X_j = [Y_j scale, t_j, p_j, ddq_j, sgn dq_j, dq_j, q_j, 1] has D = 10 n + 8 columns: those of the inertial errors
    and of the base's tilt, which all joints share, and those of the joint's own values.

    Attributes:
        gram: X^T X, (K, n, D, D).
        cross: X^T tau for the torque of every column, (K, n, D, n).
        power: tau_i^2 summed, (K, n).
        rows: rows of each fold, (K,).
        deviation: standard deviation of each recorded torque column [N m], (n,).
        weight: independent samples per row.
        lowest: lower bounds of rotor [kg m^2], Coulomb [N m], viscous [N m s/rad] increments, (3, n).
        lowest_mass: lower bounds of the errors of the links' masses, in deviations of their prior [1], (n,).
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
    lowest_mass: np.ndarray
    travel: np.ndarray
    inertia: np.ndarray

    @property
    def nominal(self) -> np.ndarray:
        """Values of the columns that give the nominal arm's torque, (n, D): p_j once, and its friction."""
        out = np.zeros(self.gram.shape[1:3])
        out[:, self.shared] = 1.0
        out[:, self.shared + COULOMB] = -self.lowest[1]
        out[:, self.shared + VISCOUS] = -self.lowest[2]
        return out

    @property
    def shared(self) -> int:
        """Number of columns that all joints share, 10 n + 2; the joint's own follow."""
        return int(self.gram.shape[2]) - OWN


def fold_equations(
    arm: NominalArm, body: RigidBody, samples: FaultSamples, mapping: ChannelMapping
) -> FoldEquations:
    """Normal equations of all folds under a mapping of the motion (its mapping of the torque does not matter)."""
    q, dq, ddq = mapping.motion(samples.q, samples.dq, samples.ddq)
    regressor = body.regressor(q, dq, ddq)
    sign = np.tanh(dq / FAULT_SIGN_WIDTH)
    nominal = regressor @ body.inertial_parameters() + arm.armature * ddq
    if samples.load.any():
        last = regressor[:, :, 10 * body.last_link : 10 * body.last_link + 10]
        nominal += np.einsum("mjp,mp->mj", last, samples.load)
    centred = q - q.mean(axis=0)
    own = np.stack([nominal, ddq, sign, dq, centred, np.ones_like(q)], axis=2)
    std = inertial_prior_std(body)
    level = _tilt_columns(body, q)
    x = np.concatenate([regressor * std, level, own], axis=2).transpose(1, 0, 2)
    folds = samples.folds
    return FoldEquations(
        gram=np.array([x[:, f].transpose(0, 2, 1) @ x[:, f] for f in folds]),
        cross=np.array([x[:, f].transpose(0, 2, 1) @ samples.tau[f] for f in folds]),
        power=np.array([(samples.tau[f] ** 2).sum(axis=0) for f in folds]),
        rows=np.array([f.stop - f.start for f in folds]),
        deviation=torque_deviation(samples.tau),
        weight=samples.weight,
        lowest=-np.array([arm.armature, arm.coulomb, arm.viscous]),
        lowest_mass=-np.maximum(body.inertial_parameters()[::10], 0.0) / std[::10],
        travel=np.ptp(q, axis=0),
        inertia=_joint_inertia(arm, body),
    )


def _tilt_columns(body: RigidBody, q: np.ndarray) -> np.ndarray:
    """Torque of a base tilted by ``ORDINARY_TILT`` about either axis across gravity [N m], (M, n, 2)."""
    gravity = body.gravity
    size = float(np.linalg.norm(gravity))
    if size == 0:
        return np.zeros((*q.shape, 2))
    across = np.linalg.svd(gravity[None] / size)[2][1:]
    return body.gravity_regressor(q) @ (ORDINARY_TILT * size * across.T)


def inertial_prior_std(body: RigidBody) -> np.ndarray:
    """Prior standard deviations of inertial errors, (10 n,), in kg, kg m, kg m^2; the last link may carry a load."""
    std = ORDINARY_INERTIALS * inertial_scale(body).reshape(-1, 10)
    link_lengths = [
        float(np.linalg.norm(body.model.jointPlacements[int(link)].translation))
        for link in body.links
    ]
    mass = ORDINARY_LOAD * float(body.inertial_parameters()[::10].sum())
    lever = ORDINARY_LEVER * max(sum(link_lengths), 0.1)
    load = np.array([mass, *[mass * lever] * 3, *[mass * lever**2] * 6])
    std[body.last_link] = np.hypot(std[body.last_link], load)
    return np.maximum(std.ravel(), 1e-9)


def torque_deviation(tau: np.ndarray) -> np.ndarray:
    """Standard deviation of each recorded torque [N m], (n,), kept from zero."""
    deviation = tau.std(axis=0)
    return np.maximum(
        deviation, max(LEAST_TORQUE_DEVIATION * float(deviation.max()), 1e-9)
    )


def _joint_inertia(arm: NominalArm, body: RigidBody) -> np.ndarray:
    """Inertia about each joint with the arm at zero, or its armature if that is more [kg m^2], (n,)."""
    inertia = np.diag(body.mass_matrix(np.zeros(body.n_joints)))
    least = 1e-3 * max(float(inertia.max()), 1e-3)
    return np.maximum(np.maximum(inertia, arm.armature), least)
