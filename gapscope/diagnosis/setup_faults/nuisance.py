"""What an arm may ordinarily have beyond its data sheet, fitted under every reading of its recordings.

The torque of joint j is taken as

    tau_j = (1 + k_j) p_j + Y_j delta + a_j ddq_j + (c0_j + c_j) sgn dq_j + (b0_j + b_j) dq_j + s_j q_j + o_j

with p the torque that the nominal arm's bodies and rotors need, known payload included, c0 and b0 its friction, Y the
inertial regressor and delta errors of the inertials, a load on the last link among them, common to all joints. All
values have a wide normal prior around zero; that of friction is at least as wide as the nominal friction, which is
often a placeholder and may be gone, and that of rotors allows for one that takes most of its joint's torque. What
physics forbids is forbidden: friction and rotor inertia in all not negative, the torque's scale not below 0.4. A wrong
sign, column or unit cannot be had by ordinary values then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
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
ROTOR, COULOMB, VISCOUS, OFFSET = 1, 2, 3, 5
"""Places of the rotor, the friction coefficients and the offset among them."""


@dataclass(frozen=True)
class ReadTorque:
    """The torque as a reading reads it, against the columns of ``FoldEquations``; K folds, n joints.

    Attributes:
        cross: X_j^T tau_j, (K, n, D).
        square: tau_j^2 summed, (K, n).
        pull: tau_j times the gravity torque g_j, summed, (K, n).
        deviation: standard deviation of each joint's torque [N m], (n,); of the recorded one, whether gravity was left
            out of it or not: gaps with and without it compare as they are.
    """

    cross: np.ndarray
    square: np.ndarray
    pull: np.ndarray
    deviation: np.ndarray


@dataclass(frozen=True)
class FoldEquations:
    """Normal equations of each fold and joint under one reading of the motion, K folds, n joints.

    X_j = [Y_j scale, t_j, p_j, ddq_j, sgn dq_j, dq_j, q_j, 1] has D = 10 n + 8 columns: those of the inertial errors
    and of the base's tilt, which all joints share, and those of the joint's own values.

    Attributes:
        gram: X^T X, (K, n, D, D).
        cross: X^T b for every torque b, the recorded columns and then each joint's gravity torque, (K, n, D, 2 n).
        products: b_i b_j summed, (K, 2 n, 2 n).
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
    products: np.ndarray
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

    def read(self, reading: Reading) -> ReadTorque:
        """The torque as a reading reads it."""
        torque = reading.torque
        source, factor = list(torque.source), np.array(torque.factor)
        joints = np.arange(len(source))
        gravity = len(joints) + joints
        # two index arrays with a slice between them: numpy puts their axis first
        by_joint = self.cross[:, joints, :, source]
        cross = by_joint.transpose(1, 0, 2) * factor[:, None]
        square = self.products[:, source, source] * factor**2
        pull = self.products[:, source, gravity] * factor
        if reading.gravity:
            own = self.products[:, gravity, gravity]
            cross = cross + self.cross[:, joints, :, gravity].transpose(1, 0, 2)
            square = square + 2 * pull + own
            pull = pull + own
        deviation = self.deviation[source] * np.abs(factor)
        return ReadTorque(cross, square, pull, deviation)


def fold_equations(
    arm: NominalArm, body: RigidBody, samples: FaultSamples, reading: Reading
) -> FoldEquations:
    """Normal equations of all folds under a reading of the motion and the torque's delay.

    Sources and factors of the torque, and whether gravity was left out of it, do not matter.
    """
    q, dq, ddq = reading.true_motion(samples.q, samples.dq, samples.ddq)
    regressor = body.regressor(q, dq, ddq)
    sign = np.tanh(dq / (FAULT_SIGN_WIDTH * arm.per_radian))
    nominal = regressor @ body.inertial_parameters() + arm.armature * ddq
    pull = body.gravity_regressor(q)
    gravity = pull @ body.gravity
    if samples.load.any():
        still = np.zeros_like(q)
        nominal += _load_torque(body, regressor, samples.load)
        gravity += _load_torque(body, body.regressor(q, still, still), samples.load)
    centred = q - q.mean(axis=0)
    own = np.stack([nominal, ddq, sign, dq, centred, np.ones_like(q)], axis=2)
    std = inertial_prior_std(body)
    level = pull @ _tilts(body)
    x = np.concatenate([regressor * std, level, own], axis=2).transpose(1, 0, 2)
    folds = samples.folds
    torques = np.concatenate([samples.torque(reading.recorded_delay), gravity], axis=1)
    return FoldEquations(
        gram=np.array([x[:, f].transpose(0, 2, 1) @ x[:, f] for f in folds]),
        cross=np.array([x[:, f].transpose(0, 2, 1) @ torques[f] for f in folds]),
        products=np.array([torques[f].T @ torques[f] for f in folds]),
        rows=np.array([f.stop - f.start for f in folds]),
        deviation=torque_deviation(samples.torque(reading.recorded_delay)),
        weight=samples.weight,
        lowest=-np.array([arm.armature, arm.coulomb, arm.viscous]),
        lowest_mass=-np.maximum(body.inertial_parameters()[::10], 0.0) / std[::10],
        travel=np.ptp(q, axis=0),
        inertia=_joint_inertia(arm, body),
    )


def _tilts(body: RigidBody) -> np.ndarray:
    """Changes of gravity by a base tilted by ``ORDINARY_TILT`` about either axis across it [m/s^2], (3, 2)."""
    gravity = body.gravity
    size = float(np.linalg.norm(gravity))
    if size == 0:
        return np.zeros((3, 2))
    across = np.linalg.svd(gravity[None] / size)[2][1:]
    return np.asarray(ORDINARY_TILT * size * across.T)


def _load_torque(
    body: RigidBody, regressor: np.ndarray, load: np.ndarray
) -> np.ndarray:
    """Torque of a known body on the last link [N m], (M, n), from the regressor of a motion."""
    last = regressor[:, :, 10 * body.last_link : 10 * body.last_link + 10]
    return np.einsum("mjp,mp->mj", last, load)


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
