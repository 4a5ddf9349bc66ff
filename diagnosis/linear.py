"""The corrected arm's torque, linearised in the parameters of all terms, as normal equations.

Around theta_0 the gap of joint j is

    y_j = r_j(theta_0) + A_j theta_0 = A_j theta + N_j delta + d_j T + noise

with r the gap at theta_0, A the derivatives of the predicted torque, N the nominal arm's inertial regressor, delta the
errors of the nominal inertials, d the rate of the predicted torque and T a skew of sampling common to all joints.
Everything later needs only A^T A and its like per piece of the data, so a log's length does not matter.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from diagnosis.gap import Healthy, filtered_torque, healthy, torque_scale
from diagnosis.terms import Terms
from effects.applied import AppliedEffect
from effects.corrected import CorrectedArm
from effects.effect import Sensing
from effects.rigid_body import point_mass_parameters
from ident.conditioning import Segment, low_pass

STEP = {"actuator_delay": 1e-4, "torque_scale": 1e-3, "load_friction": 1e-3}
"""Finite-difference steps of the parameters in which the torque is not linear; 1 for the others."""


PIECE = 1.5
"""Length of the pieces in which normal equations are kept, for the bootstrap [s]."""
MOST_PIECES = 60
"""Pieces over all folds; on long logs they grow instead."""


@dataclass(frozen=True)
class Fold:
    """Normal equations of one fold of the data, B pieces in time, n joints.

    X = [A, N, d, y] has P columns for the parameters, K for the nominal inertials, one for the skew, one for the gap.

    Attributes:
        gram: X^T W X per piece and joint, shape (B, n, P + K + 2, P + K + 2); W weighs rows down by the doubt about
            dry friction.
        rows: weight of the rows of each piece, decimated to about twice the filter's cut-off, shape (B, n).
        floor: RMS of a healthy arm on this fold where its friction is not in doubt [N m], (n,).
        independent: effective number of independent samples, (n,), in what is left when every term is fitted.
    """

    gram: np.ndarray
    rows: np.ndarray
    floor: np.ndarray
    independent: np.ndarray


class Data:
    """Folds of segments with what does not depend on the parameters: the filtered inertial regressor of each.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter, on both sides [Hz].

    Attributes:
        torque_deviation: normalisation of the torque gap over all folds [N m], (n,).
    """

    def __init__(self, arm: NominalArm, body: RigidBody, folds: list[list[Segment]], cutoff: float) -> None:
        self.arm, self.body, self.folds, self.cutoff = arm, body, folds, cutoff
        self.torque_deviation = torque_scale(np.vstack([filtered_torque(s) for fold in folds for s in fold]))
        units = _nuisance_units(body)
        self.nuisance = [[self.thin(body.regressor(*_motion(s)) * units, s) for s in fold] for fold in folds]

    def thin(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """Series of a segment, filtered, trimmed, and decimated to about twice the filter's cut-off."""
        inner = segment.inner
        return low_pass(series, segment.motion.rate, self.cutoff)[inner.start : inner.stop : self.step(segment)]

    def step(self, segment: Segment) -> int:
        """Every how many samples the rows are taken."""
        return max(1, int(segment.motion.rate // (2.5 * self.cutoff)))


class Linearisation:
    """Normal equations per fold and joint around the parameters theta_0.

    Args:
        data: the folds.
        terms: all terms that may be added.
        theta: theta_0, shape (P,).
    """

    def __init__(self, data: Data, terms: Terms, theta: np.ndarray) -> None:
        self.data, self.arm, self.body, self.terms, self.theta = data, data.arm, data.body, terms, theta
        self.folds = [self._fold(fold, nuisance) for fold, nuisance in zip(data.folds, data.nuisance, strict=True)]

    def _fold(self, segments: list[Segment], nuisance: list[np.ndarray]) -> Fold:
        gaps, columns, rates, doubts = zip(*(self._segment(s) for s in segments), strict=True)
        lengths = [len(g) for g in gaps]
        floor2 = np.average(np.array([d.steady for d in doubts]) ** 2, axis=0, weights=lengths)
        weight = 1.0 / (1.0 + np.vstack([d.sticking for d in doubts]) ** 2 / floor2)
        seconds = sum(float(s.motion.t[-1] - s.motion.t[0]) for s in segments)
        count = int(np.clip(seconds / PIECE, 2, max(2, MOST_PIECES // len(self.data.folds))))
        gap, x = np.vstack(gaps), np.vstack(columns)
        y = gap + x @ self.theta
        full = (
            np.concatenate([x, np.vstack(nuisance), np.vstack(rates)[:, :, None], y[:, :, None]], axis=2)
            * np.sqrt(weight)[:, :, None]
        ).transpose(1, 0, 2)
        cuts = np.linspace(0, len(y), count + 1).astype(int)
        spans = list(itertools.pairwise(cuts))
        gram = np.array([full[:, a:b].transpose(0, 2, 1) @ full[:, a:b] for a, b in spans])
        rows = np.array([weight[a:b].sum(axis=0) for a, b in spans])
        explaining = np.concatenate([full[:, :, : self.terms.size], full[:, :, -1:]], axis=2)
        independent = effective_samples(_richest_residual(explaining)) * weight.mean(axis=0)
        return Fold(gram, rows, np.sqrt(floor2), independent)

    def _segment(self, segment: Segment) -> tuple[np.ndarray, np.ndarray, np.ndarray, Healthy]:
        """Gap (M, n), columns (M, n, P), rate (M, n) and doubts of one segment, filtered, trimmed and decimated."""
        assert segment.torque is not None
        corrected = CorrectedArm(self.arm, self.terms.effects(self.theta))
        predicted, columns = self._derivatives(corrected, segment)
        doubt = healthy(corrected, self.body, segment)
        gap = self.data.thin(segment.torque - predicted, segment)
        sticking = doubt.sticking[:: self.data.step(segment)]
        rate = np.gradient(predicted, segment.motion.t, axis=0)
        return gap, self.data.thin(columns, segment), self.data.thin(rate, segment), Healthy(doubt.steady, sticking)

    def _derivatives(self, corrected: CorrectedArm, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        """Predicted torque (N, n), and its derivatives by theta (N, n, P)."""
        motion, terms, n = segment.motion, self.terms, self.arm.n_joints
        rigid = corrected.rigid_torque(self.body, motion)

        def recorded(arm: CorrectedArm, torque: np.ndarray) -> np.ndarray:
            return arm.recorded_torque(arm.needed_torque(torque, motion), motion)

        base = recorded(corrected, rigid)
        out = np.zeros((len(motion.t), n, terms.size))
        for effect in terms.joint_effects:
            if isinstance(effect, Sensing):
                continue
            h = STEP.get(effect.name, 1.0)
            moved = _moved(corrected, effect.name, effect.names[0], h)
            change = (recorded(moved, rigid) - base) / h
            block = terms.block(effect)
            for j in range(n):
                out[:, j, block.start + j] = change[:, j]
        q = corrected.true_position(motion.q)
        offset = terms.block(next(e for e in terms.joint_effects if isinstance(e, Sensing)))
        by_position = corrected.body(self.body).position_sensitivity(q, motion.dq, motion.ddq)
        last = self.body.last_link_regressor(q, motion.dq, motion.ddq)
        columns = np.concatenate([-by_position, last @ _payload_tangent(self.theta[terms.payload])], axis=2)
        gain = (recorded(corrected, rigid + 1e-3) - recorded(corrected, rigid - 1e-3)) / 2e-3
        through = _delayed(corrected, columns, motion.t) * np.clip(gain, 0.2, 5.0)[:, :, None]
        out[:, :, offset] = through[:, :, :n]
        out[:, :, terms.payload] = through[:, :, n:]
        return base, out


def _motion(segment: Segment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return segment.motion.q, segment.motion.dq, segment.motion.ddq


def _richest_residual(full: np.ndarray) -> np.ndarray:
    """What is left of y when all its columns are fitted, (M, n), from X of shape (n, M, columns + 1).

    A gap that some effect explains leaves noise, many independent samples; one that nothing explains leaves its own
    slow structure, few samples, and so little evidence for anything.
    """
    residual = np.empty(full.shape[:2])
    for j, x in enumerate(full):
        used = x[:, :-1][:, np.ptp(x[:, :-1], axis=0) > 0]
        scaled = used / np.linalg.norm(used, axis=0)
        residual[j] = x[:, -1] - scaled @ np.linalg.lstsq(scaled, x[:, -1], rcond=1e-6)[0]
    return residual.T


def effective_samples(series: np.ndarray) -> np.ndarray:
    """Independent samples in each column, M (1 - rho) / (1 + rho) with rho the lag-one autocorrelation; shape (n,)."""
    centred = series - series.mean(axis=0)
    power = (centred**2).sum(axis=0)
    rho = (centred[1:] * centred[:-1]).sum(axis=0) / np.where(power > 0, power, 1.0)
    rho = np.clip(rho, 0.0, 0.98)
    return np.maximum(len(series) * (1 - rho) / (1 + rho), 8.0)


def _moved(corrected: CorrectedArm, effect: str, parameter: str, step: float) -> CorrectedArm:
    """The same arm with one parameter moved by a step on all joints."""
    n = corrected.arm.n_joints
    others = tuple(e for e in corrected.effects if e.name != effect)
    value = corrected.value(effect, parameter) + step
    return CorrectedArm(corrected.arm, (*others, AppliedEffect(effect, tuple(range(1, n + 1)), {parameter: value})))


def _payload_tangent(payload: np.ndarray) -> np.ndarray:
    """Derivative of the payload's ten inertial parameters by mass and first moment, shape (10, 4)."""
    mass = payload[0]
    tangent = np.eye(10, 4)
    if abs(mass) < 1e-3:
        return tangent
    h = 1e-4 * abs(mass)
    for k in range(4):
        step = h * np.eye(4)[k]
        up, down = payload + step, payload - step
        tangent[:, k] = (
            point_mass_parameters(up[0], up[1:] / up[0]) - point_mass_parameters(down[0], down[1:] / down[0])
        ) / (2 * h)
    return tangent


def _nuisance_units(body: RigidBody) -> np.ndarray:
    """Size of a nominal arm's inertial parameters, (10 n,): what a relative error of one would change them by.

    Mass m; first moments m max(|c|, 5 cm); inertia about the joint frame, its trace / 2.
    """
    units = []
    for m, hx, hy, hz, xx, _, yy, _, _, zz in body.inertial_parameters().reshape(-1, 10):
        moment = max(float(np.hypot(np.hypot(hx, hy), hz)), 0.05 * m)
        units.append([m, *[moment] * 3, *[0.5 * (xx + yy + zz)] * 6])
    return np.array(units).ravel()


def _delayed(corrected: CorrectedArm, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Columns (N, n, K) of the needed torque, each joint's shifted by its delay, to first order in the shift."""
    delay = corrected.value("actuator_delay", "delay")
    if not delay.any():
        return columns
    return columns + delay[:, None] * np.gradient(columns, t, axis=0)
