"""Torque of the bodies behind elastic joints whose motors, not links, carry the encoders."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve_banded

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion

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
    elastic = np.flatnonzero(stiffness > 0)
    block = np.ix_(np.arange(len(torque)), elastic, elastic)
    by_position, by_velocity, mass = (matrix[block] for matrix in matrices)
    frequency = _resonances(mass, stiffness[elastic])
    # a resonance too fast to integrate deflects at once: it has neither mass nor damper
    followed = frequency <= 2 * np.pi * FASTEST_FOLLOWED
    h = 1.0 / rate
    fastest = max(frequency[followed], default=0.0)
    parts = int(np.ceil(fastest * h / PHASE_PER_STEP)) or 1
    k = by_position + np.diag(stiffness[elastic])
    d = by_velocity + np.diag(damping[elastic])
    d = d + _critical_damping(frequency, mass, h)
    keep = np.outer(followed, followed)
    m, d, k, driving = (
        finer(series, parts)
        for series in (mass * keep, d * keep, k, torque[:, elastic])
    )
    deltas = []
    for delta in _followed(m, d, k, driving, h / parts):
        all_joints = np.zeros_like(torque)
        all_joints[:, elastic] = delta[::parts]
        deltas.append(all_joints)
    return torque - of_bodies(matrices, tuple(deltas))


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


def _followed(
    m: np.ndarray, d: np.ndarray, k: np.ndarray, torque: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delta and its first two derivatives by time, (N, e) each, under a torque (N, e); step h [s]."""
    delta = _recursion(m / h**2, d / (2 * h), k, torque)
    if delta is None:
        delta = _at_once(k, torque)
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


def _recursion(
    m: np.ndarray, d: np.ndarray, k: np.ndarray, torque: np.ndarray
) -> np.ndarray | None:
    """Delta (N, e) with (m + d) x[i+1] + (k - 2 m) x[i] + (m - d) x[i-1] = torque[i], from its static value.

    Joints with m = d = 0 follow k x[i] = torque[i]. All of m, d, k have shape (N, e, e). ``None`` if the links run away
    from their motors, as on springs too soft to hold them, or with negative masses on the way of a search.
    """
    count, e = torque.shape
    moving = np.diagonal(m, axis1=1, axis2=2)[0] > 0
    below, above = 3 * e - 1, e - 1
    band = np.zeros((below + above + 1, count * e))

    def put(blocks: np.ndarray, rows: np.ndarray, shift: int) -> None:
        """Blocks (R, e, e) of equation rows (R,), for the unknowns ``shift`` samples earlier."""
        for a in range(e):
            for b in range(e):
                i = rows * e + a
                j = (rows - shift) * e + b
                band[above + i - j, j] += blocks[:, a, b]

    # equation of sample r gives x[r] from x[r-1] and x[r-2]; static joints take theirs from the same sample
    rows = np.arange(2, count)
    earlier = rows - 1
    moves = moving[:, None]
    put(np.where(moves, (m + d)[earlier], k[rows]), rows, 0)
    put(np.where(moves, (k - 2 * m)[earlier], 0.0), rows, 1)
    put(np.where(moves, (m - d)[earlier], 0.0), rows, 2)
    first = np.arange(2)
    put(np.broadcast_to(np.eye(e), (2, e, e)), first, 0)
    right = np.empty((count, e))
    right[2:] = np.where(moving, torque[1:-1], torque[2:])
    right[:2] = np.linalg.lstsq(k[0], torque[0], rcond=1e-9)[0]
    try:
        x = solve_banded((below, above), band, right.ravel())
    except np.linalg.LinAlgError:
        # a motion that grows beyond all numbers takes the last pivots to zero
        return None
    held = np.isfinite(x).all() and np.abs(x).max() <= FARTHEST
    return x.reshape(count, e) if held else None
