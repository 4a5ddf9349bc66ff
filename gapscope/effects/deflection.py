"""Torque of the bodies behind elastic joints whose motors, not links, carry the encoders."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.spring_recursion import SpringRecursion

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Derivatives of the bodies' torque by position, velocity and acceleration, (N, n, n) each."""
FASTEST_FOLLOWED = 40.0
"""A faster resonance is not integrated: the joint deflects at once [Hz]."""
PHASE_PER_STEP = 0.2
"""Steps are no longer than this share of a radian of the fastest resonance that is followed."""
FARTHEST = 1e3
"""Links that lag farther than this have run away [rad]."""
LIGHTEST = 1e-9
"""Least inertia about a joint [kg m^2]."""
CALM = 0.3
"""For this long the springs are damped critically at first: how they swung before the recording is not known [s]."""


def behind_elasticity(
    body: RigidBody,
    motion: Motion,
    torque: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """Torque of bodies that follow the motors through springs [N m], shape (N, n).

    The links lag the motors by delta, which to first order obeys

        M delta'' + (C + D) delta' + (G + K) delta = tau

    with tau the torque as if delta were zero, C and G its derivatives by velocity and position, and K, D the springs
    and dampers; the torque is tau - M delta'' - C delta' - G delta. Central differences, from rest, with more
    damping for the first ``CALM`` seconds; joints without a spring have delta = 0.

    Args:
        body: the bodies.
        motion: of the motors, N samples.
        torque: inverse dynamics of the motors' motion [N m], shape (N, n).
        stiffness, damping: per joint [N m/rad], [N m s/rad], shape (n,); 0 if there is no spring.
    """
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return through_springs(matrices, motion.rate, torque, stiffness, damping)


def through_springs(
    matrices: Matrices,
    rate: float,
    torque: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """As ``behind_elasticity``, from the derivatives of the bodies' torque at a sampling rate [Hz], (N, n)."""
    springs = Springs(matrices, rate, torque, stiffness, damping)
    return np.asarray(torque - springs.of_bodies(springs.delta[:, :, None])[:, :, 0])


class Springs:
    """Links that follow their motors through springs; the arguments are those of ``through_springs``.

    Attributes:
        elastic: the joints with a spring, (e,).
        delta: by which their links lag, on steps as fine as the resonances need, (S, e).
        followed: whether it was integrated; if links ran away from their motors, springs are taken to bend at once.
    """

    def __init__(
        self,
        matrices: Matrices,
        rate: float,
        torque: np.ndarray,
        stiffness: np.ndarray,
        damping: np.ndarray,
    ) -> None:
        self.elastic = np.flatnonzero(stiffness > 0)
        self._matrices, self._stiffness = matrices, stiffness[self.elastic]
        block = np.ix_(np.arange(len(torque)), self.elastic, self.elastic)
        by_position, by_velocity, mass = (matrix[block] for matrix in matrices)
        frequency = _resonances(mass, self._stiffness)
        # a resonance too fast to integrate deflects at once: it has neither mass nor damper
        slow = frequency <= 2 * np.pi * FASTEST_FOLLOWED
        fastest = max(frequency[slow], default=0.0)
        self._parts = int(np.ceil(fastest / rate / PHASE_PER_STEP)) or 1
        self._step = 1.0 / (rate * self._parts)
        calmed = _critical_damping(frequency, mass, 1.0 / rate)
        d = by_velocity + np.diag(damping[self.elastic]) + calmed
        keep = np.outer(slow, slow)
        k = by_position + np.diag(self._stiffness)
        series = (mass * keep, d * keep, k, torque[:, self.elastic])
        m, d, k, driving = _finer_together(series, self._parts)
        self._calmed = np.diagonal(calmed, axis1=1, axis2=2)
        self._recursion = _recursion(m / self._step**2, d / (2 * self._step), k)
        delta = _held(self._recursion, driving)
        self.followed = delta is not None
        self.delta = _at_once(k, driving) if delta is None else delta

    @cached_property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the torque [N m] by each spring's stiffness, and by its damping, (N, n, e); if followed."""
        assert self._recursion is not None
        # the damping at first is critical for the stiffness, and grows with its root
        calmed = finer(0.5 * self._calmed / self._stiffness, self._parts)
        changes = self._recursion.changes(self.delta, calmed, self._step)
        torque = -self.of_bodies(changes)
        e = len(self.elastic)
        return torque[:, :, :e], torque[:, :, e:]

    def of_bodies(self, delta: np.ndarray) -> np.ndarray:
        """What R lags, (S, e, R), take from the bodies' torque [N m], (N, n, R)."""
        rates = _with_rates(delta, self._step)
        parts = [
            matrix[:, :, self.elastic] @ x[:: self._parts]
            for matrix, x in zip(self._matrices, rates, strict=True)
        ]
        return np.asarray(sum(parts))


def _resonances(mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Highest resonance of each link on its spring over the motion [rad/s], shape (e,); mass (N, e, e)."""
    lightest = np.diagonal(mass, axis1=1, axis2=2).min(axis=0)
    # bodies of no or negative mass, on the way of a search, follow at once
    return np.sqrt(stiffness / np.maximum(lightest, LIGHTEST))


def _critical_damping(frequency: np.ndarray, mass: np.ndarray, h: float) -> np.ndarray:
    """Damping that fades over the first ``CALM`` seconds of steps of h [s], shape (N, e, e) [N m s/rad]."""
    fading = np.clip(1.0 - np.arange(len(mass)) * h / CALM, 0.0, 1.0)[:, None, None]
    return 2 * fading * frequency * mass * np.eye(len(frequency))


def finer(series: np.ndarray, parts: int) -> np.ndarray:
    """A series (N, ...) with every step cut into parts, by a cubic spline."""
    if parts == 1:
        return series
    count = len(series)
    spline = make_interp_spline(np.arange(count), series, k=3)
    fine = np.arange((count - 1) * parts + 1) / parts
    return spline(fine)


def _finer_together(series: Sequence[np.ndarray], parts: int) -> list[np.ndarray]:
    """Series (N, ...) with every step cut into parts, by one spline for all."""
    flat = [x.reshape(len(x), -1) for x in series]
    edges = np.cumsum([x.shape[1] for x in flat])[:-1]
    cut = np.split(finer(np.hstack(flat), parts), edges, axis=1)
    pairs = zip(cut, series, strict=True)
    return [x.reshape(-1, *like.shape[1:]) for x, like in pairs]


def _recursion(m: np.ndarray, d: np.ndarray, k: np.ndarray) -> SpringRecursion | None:
    """The links' motion step by step; ``None`` if a step does not determine the next, as of bodies without mass."""
    try:
        return SpringRecursion(m, d, k)
    except np.linalg.LinAlgError:
        return None


def _held(recursion: SpringRecursion | None, torque: np.ndarray) -> np.ndarray | None:
    """Delta (S, e) under a torque (S, e); ``None`` if the links run away from their motors.

    Springs too soft to hold them let them, and negative masses on the way of a search.
    """
    if recursion is None:
        return None
    delta = recursion.follow(torque)
    held = np.isfinite(delta).all() and np.abs(delta).max() <= FARTHEST
    return delta if held else None


def _with_rates(delta: np.ndarray, h: float) -> tuple[np.ndarray, ...]:
    """Delta (S, ...) and its first two derivatives by time; step h [s]."""
    rate = np.gradient(delta, h, axis=0)
    acceleration = np.gradient(rate, h, axis=0)
    # the differences of the recursion itself, except at the ends
    after, before = delta[2:], delta[:-2]
    acceleration[1:-1] = (after - 2 * delta[1:-1] + before) / h**2
    return delta, rate, acceleration


def _at_once(k: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Delta (N, e) of springs k (N, e, e) that follow a torque (N, e) without mass, within ``FARTHEST``."""
    inverse = np.linalg.pinv(k, rcond=1e-9)
    delta = np.einsum("nij,nj->ni", inverse, torque)
    return np.clip(delta, -FARTHEST, FARTHEST)


def of_bodies(
    matrices: tuple[np.ndarray, ...], series: tuple[np.ndarray, ...]
) -> np.ndarray:
    """G delta + C delta' + M delta'' [N m], shape (N, n)."""
    moved = np.flatnonzero(series[0].any(axis=0))
    out = np.zeros_like(series[0])
    for matrix, x in zip(matrices, series, strict=True):
        out += (matrix[:, :, moved] * x[:, None, moved]).sum(axis=2)
    return out
