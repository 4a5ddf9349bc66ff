"""Torque of the bodies behind elastic joints whose motors, not links, carry the encoders."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve_banded

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion

FASTEST = 40.0
"""A faster resonance is not followed: the joint bends at once [Hz]."""
STEP = 0.2
"""Steps are no longer than this share of a radian of the fastest resonance that is followed."""
CALM = 0.3
"""For this long the springs are damped critically at first: how they swung before the recording is not known [s]."""
CONTACT = 30.0
"""Frequency at which a link swings on the flank of a gear whose stiffness is not known [Hz]."""
CONTACT_DAMPING = 0.2
"""Its damping ratio [1]."""


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
        stiffness, damping: per joint [N m/rad], [N m s/rad], shape (n,); 0 where there is no spring.
    """
    elastic = np.flatnonzero(stiffness > 0)
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    own = np.ix_(np.arange(len(torque)), elastic, elastic)
    by_position, by_velocity, mass = (matrix[own] for matrix in matrices)
    lightest = np.diagonal(mass, axis1=1, axis2=2).min(axis=0)
    frequency = np.sqrt(
        stiffness[elastic] / np.maximum(lightest, 1e-9)
    )  # bodies that cannot be follow at once
    stiff = frequency > 2 * np.pi * FASTEST
    h = 1.0 / motion.rate
    parts = int(np.ceil(max(frequency[~stiff], default=0.0) * h / STEP)) or 1
    k = by_position + np.diag(stiffness[elastic])
    d = by_velocity + np.diag(damping[elastic])
    calming = np.clip(1.0 - np.arange(len(d)) * h / CALM, 0.0, 1.0)[:, None, None]
    d = d + 2 * calming * frequency * mass * np.eye(len(elastic))
    keep = np.outer(~stiff, ~stiff)
    m, d, k, driving = (
        _finer(x, parts) for x in (mass * keep, d * keep, k, torque[:, elastic])
    )
    series = [np.zeros_like(torque) for _ in range(3)]
    for out, x in zip(series, _followed(m, d, k, driving, h / parts), strict=True):
        out[:, elastic] = x[::parts]
    return torque - _of_bodies(matrices, (series[0], series[1], series[2]))


def _finer(series: np.ndarray, parts: int) -> np.ndarray:
    """A series (N, ...) with every step cut into parts, by a cubic spline."""
    if parts == 1:
        return series
    t = np.arange(len(series))
    fine = np.arange((len(series) - 1) * parts + 1) / parts
    return make_interp_spline(t, series, k=3)(fine)


def _followed(
    m: np.ndarray, d: np.ndarray, k: np.ndarray, torque: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delta and its first two derivatives by time, (N, e) each, under a torque (N, e); step h [s]."""
    delta = _recursion(m / h**2, d / (2 * h), k, torque)
    rate = np.gradient(delta, h, axis=0)
    acceleration = np.gradient(rate, h, axis=0)
    acceleration[1:-1] = (delta[2:] - 2 * delta[1:-1] + delta[:-2]) / h**2
    return delta, rate, acceleration


def behind_play(
    body: RigidBody,
    motion: Motion,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """Torque of bodies that follow the motors through free play [N m], shape (N, n).

    As ``behind_elasticity``, with the spring's torque K (delta - w / 2 sgn delta) + D delta' outside the free play
    abs(delta) < w / 2 and none inside it, where the link floats. Implicit Euler steps of the sampling rate, one joint
    at a time; a joint without a spring has a contact of ``CONTACT``.

    Args:
        body, motion, torque, stiffness, damping: as for ``behind_elasticity``.
        width: whole free play per joint [rad], shape (n,); 0 where there is none.
    """
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return torque - _of_bodies(
        matrices, _deflections(matrices, motion, torque, width, stiffness, damping)
    )


def play_columns(
    body: RigidBody, motion: Motion, torque: np.ndarray, width: float
) -> np.ndarray:
    """Torque that a little free play on each joint alone adds, per radian of it [N m/rad], shape (N, n, n).

    Entry (i, j) is that of joint i from play on joint j; of joints whose torque keeps its sign there is none.

    Args:
        body, motion, torque: as for ``behind_elasticity``.
        width: free play [rad].
    """
    matrices, none = (
        body.sensitivities(motion.q, motion.dq, motion.ddq),
        np.zeros(torque.shape[1]),
    )
    reverses = (torque.min(axis=0) < 0) & (torque.max(axis=0) > 0)
    series = _deflections(matrices, motion, torque, width * reverses, none, none)
    return (
        -sum(matrix * x[:, None, :] for matrix, x in zip(matrices, series, strict=True))
        / width
    )


def _deflections(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    motion: Motion,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delta of joints with free play and its first two derivatives by time, (N, n) each."""
    by_position, by_velocity, mass = matrices
    h, delta = 1.0 / motion.rate, np.zeros_like(torque)
    for j in np.flatnonzero(width):
        m = mass[:, j, j]
        k = stiffness[j] or float(m.mean()) * (2 * np.pi * CONTACT) ** 2
        d = (
            damping[j]
            if stiffness[j]
            else 2 * CONTACT_DAMPING * float(np.sqrt(k * m.mean()))
        )
        delta[:, j] = _play(
            torque[:, j],
            m,
            by_velocity[:, j, j],
            by_position[:, j, j],
            0.5 * width[j],
            k,
            d,
            h,
        )
    rate = np.gradient(delta, h, axis=0)
    return delta, rate, np.gradient(rate, h, axis=0)


def _play(
    torque: np.ndarray,
    m: np.ndarray,
    c: np.ndarray,
    g: np.ndarray,
    half: float,
    k: float,
    d: float,
    h: float,
) -> np.ndarray:
    """Delta (N,) of one joint with free play of half the width ``half`` [rad]."""
    out = np.empty(len(torque))
    side = 1.0 if torque[0] > 0 else -1.0
    now, before = (side * half + float(torque[0]) / k,) * 2
    inertia, drag = (m / h**2).tolist(), (c / h).tolist()
    inside = (m / h**2 + c / h + g).tolist()
    push, contact = torque.tolist(), k + d / h
    for i, a in enumerate(inside):
        b = push[i] + inertia[i] * (2 * now - before) + drag[i] * now
        new = b / a
        if new > half or new < -half:
            side = half if new > 0 else -half
            new = (b + k * side + d / h * now) / (a + contact)
        before, now = now, new
        out[i] = new
    return out


def _of_bodies(
    matrices: tuple[np.ndarray, ...], series: tuple[np.ndarray, ...]
) -> np.ndarray:
    """G delta + C delta' + M delta'' [N m], shape (N, n)."""
    parts = [
        np.einsum("nij,nj->ni", matrix, x)
        for matrix, x in zip(matrices, series, strict=True)
    ]
    return parts[0] + parts[1] + parts[2]


def _recursion(
    m: np.ndarray, d: np.ndarray, k: np.ndarray, torque: np.ndarray
) -> np.ndarray:
    """Delta (N, e) with (m + d) x[i+1] + (k - 2 m) x[i] + (m - d) x[i-1] = torque[i], from its static value.

    Joints with m = d = 0 follow k x[i] = torque[i]. All of m, d, k have shape (N, e, e).
    """
    count, e = torque.shape
    moving = np.diagonal(m, axis1=1, axis2=2)[0] > 0
    below, above = 3 * e - 1, e - 1
    band = np.zeros((below + above + 1, count * e))
    right = np.empty((count, e))
    start = np.linalg.solve(k[0], torque[0])
    newest, middle, oldest = m + d, k - 2 * m, m - d

    def put(blocks: np.ndarray, rows: np.ndarray, shift: int) -> None:
        """Blocks (R, e, e) of equation rows (R,), for the unknowns ``shift`` samples earlier."""
        for a in range(e):
            for b in range(e):
                i, j = rows * e + a, (rows - shift) * e + b
                band[above + i - j, j] += blocks[:, a, b]

    # equation of sample r gives x[r] from x[r-1] and x[r-2]; static joints take theirs from the same sample
    rows = np.arange(2, count)
    put(np.where(moving[:, None], newest[rows - 1], k[rows]), rows, 0)
    put(np.where(moving[:, None], middle[rows - 1], 0.0), rows, 1)
    put(np.where(moving[:, None], oldest[rows - 1], 0.0), rows, 2)
    right[2:] = np.where(moving, torque[1:-1], torque[2:])
    first = np.arange(2)
    put(np.broadcast_to(np.eye(e), (2, e, e)), first, 0)
    right[:2] = start
    return solve_banded((below, above), band, right.ravel()).reshape(count, e)
