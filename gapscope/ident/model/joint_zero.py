"""Encoder zeros estimated together with the parameters: what negative masses lead to asking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.model.physical_parameters import check_links, inconsistent
from gapscope.ident.signals.conditioning import Segment
from gapscope.ident.signals.samples import PER_CUTOFF, Band

WIDTH = 0.15
"""Standard deviation that zeros are believed to have before the data speak [rad]."""
KNOWN = 0.1
"""An offset is determined if the data shrink its deviation to less than this share of ``WIDTH`` [1]."""
LEAST = np.deg2rad(1.0)
"""Smaller offsets are no reason to ask [rad]."""
CERTAIN = 8.0
"""An offset of fewer standard deviations is no reason to ask; model error makes them too small on real arms [1]."""
WORTH = 0.1
"""Offsets have to lower the cost of the fit by this share [1]."""
ROUNDS = 8
CLOSE = 1e-4
"""Gauss-Newton ends when no offset moves by more [rad]."""


@dataclass(frozen=True)
class JointZeros:
    """Offsets of the encoders, recorded q = true q + offset.

    Attributes:
        offset: [rad], shape (n,).
        deviation: standard deviation [rad], shape (n,).
        known: whether data and nominal arm determine it, shape (n,).
        value: parameters x estimated with the offsets, shape (p,).
        cost: mean square of the weighted residual, plus the pull, without and with offsets [1].
        impossible: links whose parameters are those of no body, from 1, without and with offsets.
    """

    offset: np.ndarray
    deviation: np.ndarray
    known: np.ndarray
    value: np.ndarray
    cost: tuple[float, float]
    impossible: tuple[tuple[int, ...], tuple[int, ...]]

    @property
    def asked(self) -> np.ndarray:
        """Joints, from 0, whose zero must be asked about.

        The offset is large and certain, and with the offsets the fit is much better, or more bodies become possible.
        """
        size = np.abs(self.offset)
        certain = (size > LEAST) & (size > CERTAIN * self.deviation) & self.known
        cost_without, cost_with = self.cost
        better = cost_with < (1 - WORTH) * cost_without
        impossible_without, impossible_with = self.impossible
        more_possible = len(impossible_with) < len(impossible_without)
        return np.flatnonzero(certain & (better or more_possible))

    def questions(self) -> tuple[str, ...]:
        """A question about each zero that must be asked about."""
        offset, deviation = np.rad2deg(self.offset), np.rad2deg(self.deviation)
        return tuple(
            f"is the zero of joint {j + 1} right? The torque fits physical bodies with a zero that is off by "
            f"{offset[j]:+.2f} ± {deviation[j]:.2f} degrees; if so, say in the case "
            f"import: {{offsets: [...]}} with {-self.offset[j]:+.4f} rad for this joint, or calibrate it"
            for j in self.asked
        )


def estimate_zeros(
    columns: ModelColumns,
    segments: Sequence[Segment],
    law: FrictionLaw,
    band: Band,
    noise: np.ndarray,
    penalty: np.ndarray,
) -> JointZeros:
    """Estimate offsets and parameters by Gauss-Newton on tau = W(q - offset) x.

    Minimises sum |(tau - W(q - delta) x) / noise|^2 / rows + sum_k w_k (x_k - x0_k)^2 + |delta|^2 / (rows WIDTH^2);
    the columns of delta are -d tau / d q at the current x. The pull to the nominal arm decides if the links' own
    parameters could take up an offset: of the first joint about the vertical it leaves the offset open, of the last
    joint it says how far the nominal link would need to be turned.

    Args:
        columns: the model.
        segments: with torque.
        law: form of the dry friction.
        band: of both sides.
        noise: RMS residual per joint [N m], shape (n,).
        penalty: w, shape (p,).

    Source: hollerbach2008.
    """
    n, nominal = columns.arm.n_joints, columns.nominal(law)
    rows = sum(len(s.motion.t[band.rows(s)][:: band.step(s)]) for s in segments) * n
    prior = np.concatenate([nominal, np.zeros(n)])
    prior_weight = np.concatenate([rows * penalty, np.full(n, WIDTH**-2.0)])
    x: np.ndarray = nominal
    offset: np.ndarray = np.zeros(n)
    costs: list[float] = []
    impossible: list[tuple[int, ...]] = []
    for turn in range(ROUNDS):
        # the first turn holds the offsets at zero: cost and links without offsets
        gram = np.zeros((len(prior) + 1, len(prior) + 1))
        for segment in segments:
            equations = _columns(
                columns, segment, law, band, x, offset, with_zero=turn > 0
            )
            flat = (equations / noise[:, None]).reshape(-1, len(prior) + 1)
            gram += flat.T @ flat
        step = _regularised(gram, prior, prior_weight)
        costs.append(step.cost / rows)
        largest_change = np.abs(step.solution[-n:] - offset).max()
        x, offset = step.solution[:-n], step.solution[-n:]
        wrong_links = inconsistent(check_links(x[: columns.links]))
        impossible.append(tuple(check.link for check in wrong_links))
        # undamped: a search that does not converge ends after ROUNDS
        if turn > 0 and largest_change < CLOSE:
            break
    spread = step.spread[-n:]
    # a band of f Hz holds 2 f independent samples a second
    deviation = spread * np.sqrt(max(costs[-1], 1e-12) * PER_CUTOFF / 2)
    return JointZeros(
        offset=offset,
        deviation=deviation,
        known=spread < KNOWN * WIDTH,
        value=x,
        cost=(costs[0], costs[-1]),
        impossible=(impossible[0], impossible[-1]),
    )


class _Step(NamedTuple):
    """Solution of regularised least squares, its sum of squares with the penalty, and deviations at unit noise."""

    solution: np.ndarray
    cost: float
    spread: np.ndarray


def _regularised(gram: np.ndarray, prior: np.ndarray, weight: np.ndarray) -> _Step:
    """Minimum of |A z - b|^2 + sum_k w_k (z_k - prior_k)^2, with the Gram matrix of [A, b]."""
    own, right, square = gram[:-1, :-1], gram[:-1, -1], gram[-1, -1]
    normal = own + np.diag(weight)
    # columns differ by orders of magnitude: scaled to a unit diagonal
    unit = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * unit[:, None] * unit
    change = unit * np.linalg.solve(scaled, unit * (right - own @ prior))
    solution = prior + change
    residual = square - 2 * right @ solution + solution @ own @ solution
    cost = float(residual + change @ (weight * change))
    spread = unit * np.sqrt(np.diag(np.linalg.inv(scaled)))
    return _Step(solution, cost, spread)


def _columns(
    columns: ModelColumns,
    segment: Segment,
    law: FrictionLaw,
    band: Band,
    x: np.ndarray,
    delta: np.ndarray,
    *,
    with_zero: bool,
) -> np.ndarray:
    """[W, -d tau / d q, tau + its linearisation point] at the current offsets, shape (M, n, p + n + 1)."""
    m = segment.motion
    true = Motion(m.t, m.q - delta, m.dq, m.ddq)
    smooth, dry = columns.smooth(true), columns.dry(m, law)
    sensitivity = np.zeros((*m.q.shape, m.q.shape[1]))
    if with_zero:
        # the derivative by q of the torque of the bodies as they are identified now
        change = x[: columns.links] - columns.body.inertial_parameters()
        bodies = segment.bodies(columns.body).changed(change.reshape(-1, 10))
        sensitivity = -bodies.sensitivities(true.q, m.dq, m.ddq)[0]
    known = replace(segment, motion=true).known_torque(columns.body)
    right = np.asarray(segment.torque) - known + sensitivity @ delta
    equations = np.concatenate([smooth, dry, sensitivity, right[:, :, None]], axis=2)
    return band.filtered(equations, segment)[:: band.step(segment)]
