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
        dense = family.basis(
            np.linspace(0.0, family.duration, int(np.ceil(family.duration / STEP)) + 1)
        )
        self._rows = np.concatenate(
            [dense.position, dense.velocity, dense.acceleration]
        )
        self._count = len(dense.position)
        self._n = family.n_joints
        self.size = 2 * self._n + family.size

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A random x, shape (d,)."""
        return rng.standard_normal(self.size)

    def reference(self, x: np.ndarray) -> ReferenceMotion:
        """The trajectory."""
        found = self._decode(x)
        return self.family.reference(found.centre, found.share * found.gain * found.raw)

    def motion(self, x: np.ndarray, t: np.ndarray, basis: Basis) -> Motion:
        """The motion at times t [s], shape (N,), at which ``basis`` was taken."""
        found = self._decode(x)
        coefficients = found.share * found.gain * found.raw
        q, dq, ddq = (rows @ coefficients for rows in basis)
        return Motion(t, found.centre + q, dq, ddq)

    def pullback(
        self,
        x: np.ndarray,
        basis: Basis,
        gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Gradient by x, shape (d,), from those by q, dq and ddq at the samples of a basis, each (N, n).

        If several samples use the same limit equally, it is the gradient for one of them.
        """
        n, found = self._n, self._decode(x)
        by_c = sum(
            (rows.T @ g for rows, g in zip(basis, gradients, strict=True)),
            np.zeros_like(found.raw),
        )
        along = (found.raw * by_c).sum(axis=0)
        by_use = -(found.gain**2) / RESERVE * found.share * along
        limit, use_by_centre = self._active_limit(found)
        by_raw = (
            found.share * found.gain * by_c
            + by_use * found.sign / limit * self._rows[found.active].T
        )
        by_centre = gradients[0].sum(axis=0) + by_use * use_by_centre
        half = (self.limits.upper - self.limits.lower) / 2
        density = np.exp(-(x[: 2 * n] ** 2) / 2) / np.sqrt(2 * np.pi)
        by_x = (
            np.concatenate([by_centre * 2 * ROOM * half, found.gain * along]) * density
        )
        return np.concatenate([by_x, self.family.pullback(x[2 * n :], by_raw)])

    def _decode(self, x: np.ndarray) -> _Decoded:
        n, limits = self._n, self.limits
        lower, upper = limits.lower, limits.upper
        centre = (lower + upper) / 2 + ROOM * (2 * ndtr(x[:n]) - 1) * (
            upper - lower
        ) / 2
        raw = self.family.coefficients(x[2 * n :])
        blocks = (self._rows @ raw).reshape(3, self._count, n)
        most, least = blocks.max(axis=1), blocks.min(axis=1)
        above = np.stack([upper - centre, limits.velocity, limits.acceleration])
        below = np.stack([centre - lower, limits.velocity, limits.acceleration])
        uses = np.concatenate([most / above, -least / below])
        place = uses.argmax(axis=0)
        joints = np.arange(n)
        kind, sign = place % 3, np.where(place < 3, 1.0, -1.0)
        where = np.where(
            place < 3,
            blocks.argmax(axis=1)[kind, joints],
            blocks.argmin(axis=1)[kind, joints],
        )
        use = np.maximum(uses[place, joints], 1e-12)
        return _Decoded(
            centre,
            ndtr(x[n : 2 * n]),
            raw,
            RESERVE / use,
            kind * self._count + where,
            sign,
        )

    def _active_limit(self, found: _Decoded) -> tuple[np.ndarray, np.ndarray]:
        """The limit that each joint uses most, and the derivative of that use by q0 [1/rad]; each of shape (n,)."""
        kind, up = found.active // self._count, found.sign > 0
        room = np.where(
            up, self.limits.upper - found.centre, found.centre - self.limits.lower
        )
        limit = np.select(
            [kind == 0, kind == 1],
            [room, self.limits.velocity],
            self.limits.acceleration,
        )
        return limit, np.where(kind == 0, found.sign * RESERVE / found.gain / room, 0.0)
