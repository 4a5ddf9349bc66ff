"""From unbounded numbers to trajectories that keep their limits of position, velocity and acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion
from gapscope.ident.excitation.families import Basis, Family

STEP = 0.004
"""Time between the samples at which the limits are kept by construction [s]."""
RESERVE = 0.998
"""Share of the limits that is used, for what lies between those samples [1]."""
ROOM = 0.9
"""Share of the position range in which a centre may lie [1]."""


class _Decoded(NamedTuple):
    """Centre, share, S and gain as in ``Parametrisation``; the row in which a joint uses a limit most, and its sign."""

    centre: np.ndarray
    share: np.ndarray
    raw: np.ndarray
    gain: np.ndarray
    active: np.ndarray
    sign: np.ndarray


class Parametrisation:
    """Every x of R^d is a trajectory q0 + B(t) C within the limits of position, velocity and acceleration.

    x holds n numbers for the centre, q0 = middle + 0.9 (2 Phi(x) - 1) half the range; n for the amplitude, the share
    Phi(x) of what the limits allow; and those of the family. Phi is the normal distribution, so that standard normal x
    draw centre and amplitude uniformly. C_j = share_j gain_j S_j, where S are the family's coefficients and 1 / gain_j
    is the largest use of a limit of joint j over time by B S_j.

    Args:
        family: of trajectories.
        limits: of position, velocity and acceleration.
    """

    def __init__(self, family: Family, limits: Limits) -> None:
        self.family, self.limits = family, limits
        self._n = family.n_joints
        self.size = 2 * self._n + family.size
        # limits are checked at these times
        self._count = int(np.ceil(family.duration / STEP)) + 1
        dense = family.basis(np.linspace(0.0, family.duration, self._count))
        kinds = [dense.position, dense.velocity, dense.acceleration]
        self._rows = np.concatenate(kinds)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A random x, shape (d,)."""
        return rng.standard_normal(self.size)

    def reference(self, x: np.ndarray) -> ReferenceMotion:
        """The trajectory."""
        found = self._decode(x)
        return self.family.reference(found.centre, found.share * found.gain * found.raw)

    def motion(self, x: np.ndarray, t: np.ndarray, basis: Basis) -> Motion:
        """The motion at times t [s], shape (N,), at which ``basis`` was taken."""
        decoded = self._decode(x)
        coefficients = decoded.share * decoded.gain * decoded.raw
        q, dq, ddq = (rows @ coefficients for rows in basis)
        return Motion(t, decoded.centre + q, dq, ddq)

    def pullback(
        self,
        x: np.ndarray,
        basis: Basis,
        gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Gradient by x, shape (d,), from those by q, dq and ddq at the samples of a basis, each (N, n).

        If several samples use the same limit equally, it is the gradient for one of them.
        """
        n, decoded = self._n, self._decode(x)
        # by the coefficients share * gain * raw
        by_coefficients = np.zeros_like(decoded.raw)
        for rows, gradient in zip(basis, gradients, strict=True):
            by_coefficients += rows.T @ gradient
        along = (decoded.raw * by_coefficients).sum(axis=0)
        # the gain is RESERVE over the use of the limit that is used most
        by_use = -(decoded.gain**2) / RESERVE * decoded.share * along
        limit, use_by_centre = self._active_limit(decoded)
        active_rows = self._rows[decoded.active].T
        by_raw = (
            decoded.share * decoded.gain * by_coefficients
            + by_use * decoded.sign / limit * active_rows
        )
        by_centre = gradients[0].sum(axis=0) + by_use * use_by_centre
        half = (self.limits.upper - self.limits.lower) / 2
        by_share = decoded.gain * along
        by_uniform = np.concatenate([by_centre * 2 * ROOM * half, by_share])
        # centre and share are uniform: the normal distribution of x
        density = np.exp(-(x[: 2 * n] ** 2) / 2) / np.sqrt(2 * np.pi)
        by_coefficient_numbers = self.family.pullback(x[2 * n :], by_raw)
        return np.concatenate([by_uniform * density, by_coefficient_numbers])

    def _decode(self, x: np.ndarray) -> _Decoded:
        n, limits = self._n, self.limits
        lower, upper = limits.lower, limits.upper
        away = 2 * ndtr(x[:n]) - 1
        centre = (lower + upper) / 2 + ROOM * away * (upper - lower) / 2
        raw = self.family.coefficients(x[2 * n :])
        # position, velocity and acceleration, each at all times: (3, times, n)
        series = (self._rows @ raw).reshape(3, self._count, n)
        above = np.stack([upper - centre, limits.velocity, limits.acceleration])
        below = np.stack([centre - lower, limits.velocity, limits.acceleration])
        uses = np.concatenate([series.max(axis=1) / above, -series.min(axis=1) / below])
        # rows 0 to 2 are the upper limits of the three, 3 to 5 the lower ones
        most_used = uses.argmax(axis=0)
        joints = np.arange(n)
        kind, is_upper = most_used % 3, most_used < 3
        time = np.where(
            is_upper,
            series.argmax(axis=1)[kind, joints],
            series.argmin(axis=1)[kind, joints],
        )
        # a joint that does not move uses no limit
        use = np.maximum(uses[most_used, joints], 1e-12)
        return _Decoded(
            centre=centre,
            share=ndtr(x[n : 2 * n]),
            raw=raw,
            gain=RESERVE / use,
            active=kind * self._count + time,
            sign=np.where(is_upper, 1.0, -1.0),
        )

    def _active_limit(self, found: _Decoded) -> tuple[np.ndarray, np.ndarray]:
        """The limit that each joint uses most, and the derivative of that use by q0 [1/rad]; each of shape (n,)."""
        kind = found.active // self._count
        above, below = (
            self.limits.upper - found.centre,
            found.centre - self.limits.lower,
        )
        room = np.where(found.sign > 0, above, below)
        position, velocity = kind == 0, kind == 1
        limit = np.select(
            [position, velocity],
            [room, self.limits.velocity],
            self.limits.acceleration,
        )
        use = RESERVE / found.gain
        return limit, np.where(position, found.sign * use / room, 0.0)
