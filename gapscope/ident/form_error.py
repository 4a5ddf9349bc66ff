"""Form error of an identification: what no column has of the friction that an arm has.

Whatever law is chosen, joint j is taken to leave

    y_j = W_j beta + f_j(q_j, dq_j) + e_j,    f_j = sum_k phi_k u_k,    u_k ~ N(0, omega_k^2)

with an unknown function f_j of its own state, as a contrast takes it (``gapscope.model.equations``): waves, which are
smooth and share one amplitude, and dry functions sgn v exp(-(v / vs)^2) of several speeds vs, each of its own. The same
motion has the same f again, so that least squares, which takes it for noise, is pulled by it as often as it is
repeated. An amplitude follows from the evidence (mackay1992b), with gamma the number of values that data determine,

    omega^2 = sum u^2 / gamma.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.ident.model.base_parameters import TINY
from gapscope.ident.model.linear_problem import STRIBECK_SPEEDS, Problem
from gapscope.ident.samples import Samples
from gapscope.model.design import PRECISE, WAVES, drawn_waves
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.equations import ROUNDS, SETTLED

DRY_SPEEDS = (*FRICTION_SMOOTHING * np.array([1, 2, 4]), *STRIBECK_SPEEDS[:2])
"""Speeds vs of the dry functions [rad/s], from that over which the sign is smoothed. (budget)"""


def form_columns(samples: Samples) -> tuple[np.ndarray, ...]:
    """The unknown functions in the band of the samples: waves, (M, n, K), and each dry function, (M, n, 1)."""
    arm, motions = samples.columns.arm, [s.motion for s in samples.segments]
    n = arm.n_joints

    def state(motion: Motion) -> np.ndarray:
        return np.hstack([motion.q, motion.dq])

    spread = np.concatenate([state(motion) for motion in motions]).std(axis=0)
    spread = np.maximum(spread, TINY)

    def columns(motion: Motion) -> np.ndarray:
        own, speed = state(motion) / spread, motion.dq / arm.per_radian
        smooth = [drawn_waves(own[:, [j, n + j]], WAVES[0]) for j in range(n)]
        dry = [np.sign(speed) * np.exp(-((speed / vs) ** 2)) for vs in DRY_SPEEDS]
        return np.concatenate([np.stack(smooth, axis=1), np.stack(dry, axis=2)], axis=2)

    every = samples.filtered_each(columns)
    ends = np.arange(WAVES[0], every.shape[2])
    return tuple(np.split(every, ends, axis=2))


@dataclass(frozen=True)
class FormError:
    """What a problem of n joints leaves beside its columns, as noise and as unknown functions.

    Attributes:
        noise: e [N m], (N, n).
        moment: E[u u^T] of all functions, joint by joint, as the data leave it, (n K, n K).
    """

    noise: np.ndarray
    moment: np.ndarray

    def covariance(self, left: np.ndarray, problem: Problem) -> np.ndarray:
        """Of an estimate that makes Z^T (y - W beta) zero, by the unknown functions, (b, b); Z of shape (N, n, b)."""
        functions = np.concatenate(problem.forms, axis=2)
        gram = np.einsum("nja,njb->ab", left, problem.matrix, optimize=True)
        scores = [left[:, j].T @ functions[:, j] for j in range(problem.n_joints)]
        pull = np.linalg.solve(gram, np.hstack(scores))
        return np.asarray(pull @ self.moment @ pull.T)


def form_error(problem: Problem, beta: np.ndarray) -> FormError:
    """Noise and amplitudes by the evidence of what an estimate leaves.

    Args:
        problem: with the columns of its unknown functions.
        beta: the estimate, (b,).
    """
    functions = np.concatenate(problem.forms, axis=2)
    (_, n, count), b = functions.shape, len(beta)
    counts = [each.shape[2] for each in problem.forms]
    starts = np.cumsum([0, *counts[:-1]])
    left = problem.residual(beta)
    scale2 = np.maximum((problem.torque**2).mean(axis=0), TINY)
    variance = np.tile(PRECISE**2 * scale2[:, None], count)
    noise, noise2 = left, np.maximum((left**2).mean(axis=0), 1e-18 * scale2)
    # sums of products of [W, functions of the joint, what is left], joint by joint
    parts = [problem.matrix, functions, left[:, :, None]]
    every = np.concatenate(parts, axis=2).transpose(1, 2, 0)
    sums = every @ every.transpose(0, 2, 1)
    for _ in range(ROUNDS):
        weighted = sums / noise2[:, None, None]
        # what is shared by all joints eliminated from what each has of its own
        shared = weighted[:, :b, :b].sum(axis=0)
        cross = np.concatenate(list(weighted[:, b:-1, :b]))
        pull = weighted[:, :b, -1].sum(axis=0)
        scale = 1 / np.sqrt(np.diag(shared).clip(TINY))
        inverse = np.linalg.pinv(shared * np.outer(scale, scale), hermitian=True)
        inverse = inverse * np.outer(scale, scale)
        information = -cross @ inverse @ cross.T
        right = weighted[:, b:-1, -1].ravel() - cross @ inverse @ pull
        for j, own in enumerate(weighted[:, b:-1, b:-1]):
            at = slice(j * count, (j + 1) * count)
            information[at, at] += own
        size = np.sqrt(variance.ravel())
        inner = np.linalg.inv(np.eye(n * count) + information * np.outer(size, size))
        value = size * (inner @ (size * right))
        change = inverse @ (pull - cross.T @ value)
        noise = left - problem.matrix @ change
        noise = noise - np.einsum("njk,jk->nj", functions, value.reshape(n, count))
        inflation = variance_inflation(noise, problem.group)
        noise2 = np.maximum((noise**2).mean(axis=0) * inflation, 1e-18 * scale2)
        # as many as data determine, of the functions that share an amplitude
        determined = (1.0 - np.diag(inner)).reshape(n, count)
        squares = np.add.reduceat(value.reshape(n, count) ** 2, starts, axis=1)
        gamma = np.add.reduceat(determined, starts, axis=1)
        before = variance
        variance = np.repeat(squares / np.maximum(gamma, TINY), counts, axis=1)
        # what is a millionth of the torque is none
        variance = np.maximum(variance, 1e-12 * scale2[:, None])
        if (np.abs(variance - before) <= SETTLED * before).all():
            break
    # what the data say of one function they say of others too: those that replace each other do not add up
    moment = np.outer(value, value) + inner * np.outer(size, size)
    return FormError(noise, moment)
