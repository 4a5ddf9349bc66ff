"""What the integrator of a controller held when a recording began, which no recording shows.

Computed from zero, the torque of a stretch lacks a constant z for each joint. It is what makes an arm explain the
torque best that has, beside the nominal one and another friction, nothing or one thing of its own: with p the nominal
torque,

    tau_j + z_j = p_j + c_j sgn dq_j + b_j dq_j + X_j theta,

X the columns of a load on the last link, of a tilted base, of a scale of each joint's torque, or of errors of all
links. Friction and theta are common to all stretches of a case. Which X there is, if any, is chosen by the Bayesian
information criterion over independent samples: free columns that nothing asks for would shift the constants, which
gravity resembles. What an arm has beyond all that stays in the constants. Source: schwarz1978.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.nuisance import inertial_prior_std
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    INTEGRATOR_SAMPLES,
    LEAST_INTEGRATOR_MISFIT,
    MOTION_INDEPENDENT_RATE,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
)
from gapscope.model.effective_samples import motion_samples
from gapscope.model.torque_gap import torque_scale

FITS = 3
"""Fits of one choice of columns, each with the weights that the one before it left."""


def integrator_starts(
    arm: NominalArm, stretches: Sequence[Recording]
) -> list[np.ndarray]:
    """Torque of the integrator at the start of each stretch [N m], (n,) each.

    Args:
        arm: the nominal arm.
        stretches: of all recordings, without gaps, their torque computed with an integrator that starts from zero.
    """
    body = RigidBody(arm)
    rows = [_Rows(arm, body, condition(s)[0]) for s in stretches]
    seconds = sum(stretch.duration for stretch in stretches)
    independent = motion_samples(seconds, MOTION_INDEPENDENT_RATE)
    choices = [_fitted(rows, name, independent) for name in rows[0].columns]
    _, starts = min(choices, key=lambda choice: choice[0])
    return list(starts)


def _fitted(
    rows: Sequence[_Rows], name: str, independent: float
) -> tuple[float, np.ndarray]:
    """Information criterion of one choice of columns [1], and the constants of each stretch [N m], (R, n).

    Constants are eliminated: every column and the torque lose their mean over each stretch.
    """
    missing = [part.missing for part in rows]
    columns = [np.concatenate([p.friction, p.columns[name]], axis=2) for p in rows]
    y = np.concatenate([m - m.mean(axis=0) for m in missing])
    x = np.concatenate([c - c.mean(axis=0) for c in columns])
    least = LEAST_INTEGRATOR_MISFIT * torque_scale(np.concatenate(missing))
    misfit = torque_scale(np.concatenate(missing))
    size = x.shape[2]
    for _ in range(FITS):
        # columns have the size of what may ordinarily be: a unit prior
        weighted = x / misfit[:, None]
        normal = np.einsum("mjp,mjq->pq", weighted, weighted) + np.eye(size)
        theta = np.linalg.solve(normal, np.einsum("mjp,mj->p", weighted, y / misfit))
        left = y - x @ theta
        misfit = np.maximum(np.sqrt((left**2).mean(axis=0)), least)
    criterion = 2 * independent * np.log(misfit).sum() + size * np.log(independent)
    starts = [
        (c @ theta - m).mean(axis=0) for c, m in zip(columns, missing, strict=True)
    ]
    return float(criterion), np.array(starts)


class _Rows:
    """Few samples of a stretch, M of them, behind the filter of the torque gap.

    Attributes:
        missing: computed minus nominal torque [N m], (M, n).
        friction: columns of another friction, (M, n, 2 n), which every choice has.
        columns: those of each choice by name, (M, n, P).
    """

    def __init__(self, arm: NominalArm, body: RigidBody, segment: Segment) -> None:
        motion, inner = segment.motion, segment.inner
        assert segment.torque is not None
        nominal = CorrectedArm(arm).predict(segment.bodies(body), motion)
        step = max(1, len(motion.t[inner]) // INTEGRATOR_SAMPLES)

        def thinned(series: np.ndarray) -> np.ndarray:
            flat = series.reshape(len(series), -1)
            smooth = low_pass(flat, motion.rate, TORQUE_CUTOFF)[inner][::step]
            return smooth.reshape(-1, *series.shape[1:])

        q, dq, ddq = motion.q, motion.dq, motion.ddq
        scale = torque_scale(nominal)
        sign = np.tanh(dq / FAULT_SIGN_WIDTH)
        speed = np.maximum(np.abs(dq).max(axis=0), 1e-3)
        regressor = body.regressor(q, dq, ddq) * inertial_prior_std(body)
        last = slice(10 * body.last_link, 10 * body.last_link + 10)
        self.missing = thinned(segment.torque - nominal)
        friction = [_diagonal(sign * scale), _diagonal(dq / speed * scale)]
        self.friction = thinned(np.concatenate(friction, axis=2))
        size = float(np.linalg.norm(body.gravity))
        choices = {
            "load": regressor[:, :, last],
            "tilt": body.gravity_regressor(q) * size,
            "scales": _diagonal(nominal),
            "links": regressor,
        }
        nothing = {"nothing": np.zeros((*self.missing.shape, 0))}
        self.columns = nothing | {name: thinned(x) for name, x in choices.items()}


def _diagonal(series: np.ndarray) -> np.ndarray:
    """A column per joint that acts on that joint alone, (M, n, n), from (M, n)."""
    return np.einsum("mj,jk->mjk", series, np.eye(series.shape[1]))
