"""Torque of the bodies behind elastic joints whose motors, not links, carry the encoders."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from arm.dynamics import RigidBody
from arm.motion import Motion

FASTEST = 0.7
"""A resonance above this share of the sampling rate, in rad per sample, is not followed: the joint bends at once."""

CALM = 0.3
"""For this long the springs are damped critically at first: how they swung before the recording is not known [s]."""


def behind_elasticity(
    body: RigidBody, motion: Motion, torque: np.ndarray, stiffness: np.ndarray, damping: np.ndarray
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
    by_position, by_velocity, mass = body.sensitivities(motion.q, motion.dq, motion.ddq)
    own = np.ix_(np.arange(len(torque)), elastic, elastic)
    k = by_position[own] + np.diag(stiffness[elastic])
    d = by_velocity[own] + np.diag(damping[elastic])
    m, h = mass[own], 1.0 / motion.rate
    frequency2 = stiffness[elastic] / np.diagonal(m, axis1=1, axis2=2).min(axis=0)
    stiff = np.sqrt(frequency2) * h > FASTEST
    m[:, stiff], d[:, stiff] = 0.0, 0.0
    m[:, :, stiff], d[:, :, stiff] = 0.0, 0.0
    calming = np.clip(1.0 - np.arange(len(d)) * h / CALM, 0.0, 1.0)[:, None, None]
    d = d + 2 * calming * np.sqrt(frequency2) * m * np.eye(len(elastic))
    delta = np.zeros_like(torque)
    delta[:, elastic] = _recursion(m / h**2, d / (2 * h), k, torque[:, elastic])
    rate = np.gradient(delta, h, axis=0)
    acceleration = np.gradient(rate, h, axis=0)
    acceleration[1:-1] = (delta[2:] - 2 * delta[1:-1] + delta[:-2]) / h**2
    return torque - sum(
        np.einsum("nij,nj->ni", matrix, x)
        for matrix, x in ((by_position, delta), (by_velocity, rate), (mass, acceleration))
    )


def _recursion(m: np.ndarray, d: np.ndarray, k: np.ndarray, torque: np.ndarray) -> np.ndarray:
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
