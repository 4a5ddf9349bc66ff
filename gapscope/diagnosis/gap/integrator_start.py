"""What the integrator of a controller held when a recording began, which no recording shows.

Computed from zero, the torque of a stretch lacks a constant for each joint. It is estimated with what the arm may
ordinarily have beside its data sheet: with p the torque of the nominal arm,

    tau_j + z_j = p_j + Y_j delta + c_j sgn dq_j + b_j dq_j,

z one value per stretch and joint, delta errors of the inertials, a load on the last link among them, common to all
joints and stretches. delta, c and b have wide normal priors around zero, z has none. The prior decides if a motion
is too small to tell a constant from gravity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.diagnosis.setup_faults.nuisance import inertial_prior_std
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    INTEGRATOR_SAMPLES,
    ORDINARY_FRICTION,
    ORDINARY_GAP_DEVIATION,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import Segment, condition, position_cutoff


def integrator_starts(
    arm: NominalArm, stretches: Sequence[Recording]
) -> list[np.ndarray]:
    """Torque of the integrator at the start of each stretch [N m], (n,) each.

    Args:
        arm: the nominal arm.
        stretches: of one recording without gaps, their torque computed with an integrator that starts from zero.
    """
    cutoff = position_cutoff(tuple(stretches))
    body, n = RigidBody(arm), arm.n_joints
    rows = [_Rows(arm, body, condition(s, cutoff)[0]) for s in stretches]
    scale = torque_scale(np.vstack([r.missing for r in rows]))
    weight = 1.0 / (ORDINARY_GAP_DEVIATION * scale)
    std = np.concatenate([inertial_prior_std(body), *[ORDINARY_FRICTION * scale] * 2])
    size = len(std)
    count = size + n * len(rows)
    normal = np.zeros((count, count))
    right = np.zeros(count)
    normal[:size, :size] = np.diag(1.0 / std**2)
    for k, part in enumerate(rows):
        for j in range(n):
            # the joint's own constant in this stretch comes with the opposite sign
            x = np.zeros((len(part.missing), count))
            x[:, :size] = part.columns[:, j]
            x[:, size + n * k + j] = -1.0
            x *= weight[j]
            normal += x.T @ x
            right += x.T @ (part.missing[:, j] * weight[j])
    values = np.linalg.solve(normal, right)[size:]
    return list(values.reshape(-1, n))


class _Rows:
    """Few samples of a stretch: ``missing`` is recorded minus nominal torque, (M, n), ``columns`` (M, n, 12 n)."""

    def __init__(self, arm: NominalArm, body: RigidBody, segment: Segment) -> None:
        motion, inner = segment.motion, segment.inner
        assert segment.torque is not None
        nominal = CorrectedArm(arm).predict(segment.bodies(body), motion)
        step = max(1, len(motion.t[inner]) // INTEGRATOR_SAMPLES)
        self.missing = (segment.torque - nominal)[inner][::step]
        q, dq, ddq = (x[inner][::step] for x in (motion.q, motion.dq, motion.ddq))
        sign = np.tanh(dq / FAULT_SIGN_WIDTH)
        speed = np.maximum(np.sqrt((dq**2).mean(axis=0)), 1e-3)
        friction = [_diagonal(sign), _diagonal(dq / speed)]
        self.columns = np.concatenate([body.regressor(q, dq, ddq), *friction], axis=2)


def _diagonal(series: np.ndarray) -> np.ndarray:
    """A column per joint that acts on that joint alone, (M, n, n), from (M, n)."""
    return np.einsum("mj,jk->mjk", series, np.eye(series.shape[1]))
