"""Encoder zeros estimated together with the parameters: what negative masses lead to asking."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky
from scipy.optimize import least_squares

from gapscope.arm.motions.motion import Motion
from gapscope.ident.model.base_parameters import TINY
from gapscope.ident.model.friction import Choice, pulled_solution
from gapscope.ident.model.physical_parameters import check_links, inconsistent
from gapscope.ident.samples import PER_CUTOFF, Samples
from gapscope.model.conditioning import Segment

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
LARGEST = np.deg2rad(45.0)
"""Offsets are sought up to this; one that ends there is not determined [rad]."""
CLOSE = 1e-4
"""The search ends when offsets move by less than this share of their size [1]..."""
SETTLED = 1e-5
"""...or the cost falls by less than this share [1]: less than the noise of the data makes of it."""


@dataclass(frozen=True)
class JointZeros:
    """Offsets of the encoders, recorded q = true q + offset.

    Attributes:
        offset: [rad], shape (n,).
        deviation: standard deviation [rad], shape (n,).
        known: whether data and nominal arm determine it, shape (n,); no joint if the search did not converge.
        asked: joints, from 0, whose zero must be asked about: the offset is large and certain, and with the offsets the
            fit is much better, or more bodies become possible.
    """

    offset: np.ndarray
    deviation: np.ndarray
    known: np.ndarray
    asked: np.ndarray

    def questions(self) -> tuple[str, ...]:
        """A question about each zero that must be asked about."""
        offset, deviation = np.rad2deg(self.offset), np.rad2deg(self.deviation)
        return tuple(
            f"is the zero of joint {j + 1} right? The torque fits physical bodies with a zero that is off by "
            f"{offset[j]:+.2f} ± {deviation[j]:.2f} degrees; if so, say in the case "
            f"import: {{offsets: [...]}} with {-self.offset[j]:+.4f} rad for this joint, or calibrate it"
            for j in self.asked
        )


def estimate_zeros(samples: Samples, choice: Choice, penalty: np.ndarray) -> JointZeros:
    """Estimate offsets and parameters of tau = W(q - offset) x.

    Minimises sum |(tau - W(q - delta) x) / noise|^2 / rows + sum_k w_k (x_k - x0_k)^2 + |delta|^2 / (rows WIDTH^2)
    over |delta| <= LARGEST by a trust region; x follows from delta by linear least squares (variable projection). The
    pull to the nominal arm decides if the links' own parameters could take up an offset: of the first joint about the
    vertical it leaves the offset open, of the last joint it says how far the nominal link would need to be turned.

    Args:
        samples: with their segments, the model and the band of both sides.
        choice: form of the dry friction, and RMS residual per joint.
        penalty: w, shape (p,).

    Source: hollerbach2008, golub1973.
    """
    columns = samples.columns
    n, rows = columns.arm.n_joints, samples.torque.size

    # the solver asks for the residual and its derivative at the same offsets
    @cache
    def at(offset: tuple[float, ...]) -> _Reduced:
        return _reduced(samples, choice, rows * penalty, np.array(offset))

    widest = LARGEST * columns.arm.per_radian
    found = least_squares(
        lambda offset: at(tuple(offset)).residual,
        np.zeros(n),
        jac=lambda offset: at(tuple(offset)).jacobian,
        bounds=(-widest, widest),
        xtol=CLOSE,
        ftol=SETTLED,
    )
    without, final = at((0.0,) * n), at(tuple(found.x))
    impossible, with_offsets = (
        len(inconsistent(check_links(one.value[: columns.links])))
        for one in (without, final)
    )
    # a band of f Hz holds 2 f independent samples a second
    noise_scale = np.sqrt(max(final.cost / rows, TINY) * PER_CUTOFF / 2)
    deviation = final.spread * noise_scale
    known = (final.spread < KNOWN * WIDTH) & (found.active_mask == 0)
    # where a slide's zero lies shows in the levers alone
    known &= ~np.array(columns.arm.sliding) & bool(found.success)
    size = np.abs(found.x)
    certain = known & (size > LEAST) & (size > CERTAIN * deviation)
    better = final.cost < (1 - WORTH) * without.cost or with_offsets < impossible
    asked = np.flatnonzero(certain & better)
    return JointZeros(found.x, deviation, known, asked)


class _Reduced(NamedTuple):
    """The problem at some offsets with x eliminated.

    Attributes:
        value: the best x, shape (p,).
        residual: of unit noise, in n + 1 orthonormal directions; its square is the cost.
        jacobian: its derivative by the offsets, shape (n + 1, n).
    """

    value: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray

    @property
    def cost(self) -> float:
        """Sum of squares at unit noise, penalties included."""
        return float(self.residual @ self.residual)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation of the offsets at unit noise [rad], shape (n,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.jacobian.T @ self.jacobian)))


def _reduced(
    samples: Samples, choice: Choice, weight: np.ndarray, offset: np.ndarray
) -> _Reduced:
    """Regularised least squares at some offsets, x eliminated by the triangular factor of [W, S, y]."""
    columns, law, p, n = samples.columns, choice.law, len(weight), len(offset)
    nominal, body = columns.nominal(law), columns.body
    true = [replace(s.motion, q=s.motion.q - offset) for s in samples.segments]

    def stacked(part: Callable[[Segment, Motion], np.ndarray]) -> np.ndarray:
        """Columns of each segment, (N, n, k), in the band, thinned, at unit noise, one row for each joint; (M n, k)."""
        pairs = zip(samples.segments, true, strict=True)
        parts = [samples.band.thinned(part(s, motion), s) for s, motion in pairs]
        rows = np.concatenate(parts) / choice.noise[:, None]
        return rows.reshape(-1, rows.shape[2])

    def equations(segment: Segment, motion: Motion) -> np.ndarray:
        known = replace(segment, motion=motion).known_torque(body)
        torque = np.asarray(segment.torque) - known
        dry = columns.dry(segment.motion, law)
        parts = [columns.smooth(motion), dry, torque[:, :, None]]
        return np.concatenate(parts, axis=2)

    whole = stacked(equations)
    value = pulled_solution(whole.T @ whole, 1, weight, nominal)
    change = (value[: columns.links] - body.inertial_parameters()).reshape(-1, 10)

    def slopes(segment: Segment, motion: Motion) -> np.ndarray:
        """S = -d tau / d q with the bodies as they are identified now."""
        bodies = segment.bodies(body).changed(change)
        return -bodies.sensitivities(motion.q, motion.dq, motion.ddq)[0]

    whole = np.hstack([whole[:, :-1], stacked(slopes), whole[:, -1:]])
    gram = whole.T @ whole
    # penalties are further rows: sqrt(w) (x - x0), and (delta + step) / WIDTH
    pull = np.concatenate([weight, np.full(n, WIDTH**-2.0)])
    target = np.concatenate([nominal, -offset])
    gram[:-1, :-1] += np.diag(pull)
    gram[:-1, -1] += pull * target
    gram[-1, :-1] = gram[:-1, -1]
    gram[-1, -1] += target @ (pull * target)
    # rows below those of x hold what x cannot explain: [S, y] in n + 1 directions
    rest = _triangular(gram)[p:, p:]
    return _Reduced(value, rest[:, -1], -rest[:, :-1])


def _triangular(gram: np.ndarray) -> np.ndarray:
    """Upper triangular R with R^T R the Gram matrix, of columns that differ by orders of magnitude."""
    unit = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = gram / unit[:, None] / unit
    # a little weight keeps the factor real where columns depend on each other to rounding
    return cholesky(scaled + 1e-13 * np.eye(len(gram))) * unit
