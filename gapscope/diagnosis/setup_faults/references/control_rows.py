"""What a PD law is compared on: tracking errors and torque of a case, in rows to fit and rows to judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.reading import references
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    LAW_BLOCKS,
    LEAST_MOTION_SHARE,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    low_pass,
)

CLIPPED = 0.98
"""Torque over its limit from which on it may be clipped [1]."""


@dataclass(frozen=True)
class ControlRows:
    """Rows of all recordings with a reference, M of n joints.

    Attributes:
        error: q_ref - q [rad], (M, n).
        dq_ref, dq: velocities [rad/s], (M, n).
        torque: recorded less the declared feedforward [N m], (M, n); that which the nominal arm needs if none was
            recorded.
        needed: what the nominal arm needs, friction included [N m], (M, n).
        feedforward: declared [N m], (M, n); zero without a declared controller.
        gravity: torque of gravity of 1 m/s^2 along each axis of the base [N m], on the reference, (M, n, 3); zero
            without a declared feedforward, which may believe in another gravity.
        recorded: whether ``torque`` was.
        fitted: rows to fit, (M,); the others judge.
        moves: joints that move, (n,).
        free: rows on which a joint's torque is below its limit, (M, n).
    """

    error: np.ndarray
    dq_ref: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    needed: np.ndarray
    feedforward: np.ndarray
    gravity: np.ndarray
    recorded: bool
    fitted: np.ndarray
    moves: np.ndarray
    free: np.ndarray

    @property
    def rate(self) -> np.ndarray:
        """dq_ref - dq [rad/s], (M, n)."""
        return self.dq_ref - self.dq

    def any_gravity(self, joint: int) -> list[np.ndarray]:
        """Columns of gravity in any direction, (M,) each; none without a declared feedforward."""
        columns = self.gravity[:, joint].T
        return list(columns) if columns.any() else []

    def friction(self, joint: int) -> list[np.ndarray]:
        """Columns of dry and viscous friction, (M,) each."""
        dq = self.dq[:, joint]
        return [np.tanh(dq / FAULT_SIGN_WIDTH), dq]

    def fit(
        self, joint: int, target: np.ndarray, columns: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, float]:
        """Coefficients of columns and an offset for a target, and what they leave of it on rows that judge.

        Args:
            joint: from 0.
            target: (M, n), of which the joint's column is explained.
            columns: (M,) each.
        """
        y = target[:, joint]
        x = np.column_stack([*columns, np.ones_like(y)])
        usable = self.free[:, joint]
        fitted = self.fitted & usable
        coefficients = np.linalg.lstsq(x[fitted], y[fitted], rcond=None)[0]
        return coefficients, self.left(joint, y - x @ coefficients, y)

    def left(self, joint: int, residual: np.ndarray, target: np.ndarray) -> float:
        """RMS of a residual over the target's deviation on the rows that judge [1], (M,) both."""
        judged = ~self.fitted & self.free[:, joint]
        deviation = max(float(target[judged].std()), 1e-12)
        return float(np.sqrt(np.mean(residual[judged] ** 2))) / deviation


def control_rows(case: Case) -> ControlRows | None:
    """Rows of a case in the band of the torque gap; ``None`` without references."""
    recordings = [r for r in case.recordings if r.q_ref is not None]
    if not recordings:
        return None
    recorded = all(r.tau is not None for r in recordings)
    body = RigidBody(case.arm)
    parts = [_rows(case, body, r, recorded) for r in recordings]
    series = [np.concatenate(x) for x in zip(*parts, strict=True)]
    error, dq_ref, dq, torque, needed, forward, gravity, free = series
    planned = np.max(
        [np.ptp(references(r, "controller")[0], axis=0) for r in recordings], axis=0
    )
    return ControlRows(
        error,
        dq_ref,
        dq,
        torque,
        needed,
        forward,
        gravity,
        recorded,
        np.concatenate([_fitted(len(p[0])) for p in parts]),
        planned > LEAST_MOTION_SHARE * planned.max(),
        free.astype(bool),
    )


def _fitted(count: int) -> np.ndarray:
    """Every other block of a recording's rows, (count,)."""
    return np.arange(count) * LAW_BLOCKS // count % 2 == 0


def _rows(
    case: Case, body: RigidBody, recording: Recording, recorded: bool
) -> list[np.ndarray]:
    """Error, velocities, torque, needed torque, and rows below the limit of one recording, (M, n) each."""
    segments = condition(recording)
    rows: list[list[np.ndarray]] = []
    for segment in segments:
        motion = segment.motion
        q_ref, dq_ref, q, dq = _on_grid(recording, motion.t, _filter_delay(case))
        bodies = body.carrying(segment.payload)
        needed = CorrectedArm(case.arm).predict(bodies, motion)
        torque = needed if segment.torque is None or not recorded else segment.torque
        limit = case.arm.torque_limit
        free = np.ones_like(torque)
        if limit is not None and recorded:
            free = (np.abs(torque) < CLIPPED * limit).astype(float)
        forward = np.zeros_like(torque)
        gravity = np.zeros((*torque.shape, 3))
        if isinstance(case.controller, PD):
            # finite differences of a log at 100 Hz lose some per cent of a fast reference's acceleration
            ddq_ref = make_interp_spline(motion.t, dq_ref, k=5)(motion.t, 1)
            kind = case.controller.feedforward
            forward = feedforward(case.arm, body, kind, q_ref, dq_ref, ddq_ref)
            if kind != "none":
                gravity = body.gravity_regressor(q_ref)
        filtered = [
            low_pass(x, motion.rate, TORQUE_CUTOFF)[segment.inner]
            for x in (q_ref - q, dq_ref, dq, torque - forward, needed, forward, gravity)
        ]
        rows.append([*filtered, free[segment.inner]])
    return [np.concatenate(x) for x in zip(*rows, strict=True)]


def _filter_delay(case: Case) -> float:
    """Delay of the declared controller's velocity filter at low frequency, 2 zeta / w [s]; 0 if there is none."""
    controller = case.controller
    if controller is None or controller.velocity_cutoff is None:
        return 0.0
    return controller.velocity_damping / (np.pi * controller.velocity_cutoff)


def _on_grid(recording: Recording, t: np.ndarray, delay: float) -> list[np.ndarray]:
    """q_ref, dq_ref, q, dq of a recording at other times [s], (M, n) each.

    A velocity that was not recorded is that of the positions a ``delay`` ago, as a controller's filter has it.
    """
    q_ref, dq_ref = references(recording, "controller")
    dq, dq_time = recording.dq, t
    if dq is None:
        dq, dq_time = np.gradient(recording.q, recording.t, axis=0), t - delay
    series = ((t, q_ref), (t, dq_ref), (t, recording.q), (dq_time, dq))
    return [
        np.column_stack([np.interp(at, recording.t, column) for column in x.T])
        for at, x in series
    ]
