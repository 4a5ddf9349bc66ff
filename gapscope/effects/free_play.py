"""Torque of the bodies behind free play whose motors, not links, carry the encoders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.deflection import (
    FARTHEST,
    LIGHTEST,
    Matrices,
    finer,
    of_bodies,
)

CONTACT = 40.0
"""Frequency at which a link swings on the flank of a gear whose stiffness is not known [Hz]."""
CONTACT_DAMPING = 0.6
"""Its damping ratio [1]: teeth in grease hardly rebound, and no recording tells when a rebound ends."""
LONGEST_STEP = 2e-3
"""Steps with which free play is followed are no longer [s]: within one a link hardly leaves its flank."""


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
    abs(delta) < w / 2 and none inside it, where the link floats. Implicit Euler steps of ``LONGEST_STEP``, one joint
    at a time; a joint without a spring has a contact of ``CONTACT``.

    Args:
        body, motion, torque, stiffness, damping: as for ``behind_elasticity``.
        width: whole free play per joint [rad], shape (n,); 0 if there is none.
    """
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return through_play(matrices, motion.rate, torque, width, stiffness, damping)


def through_play(
    matrices: Matrices,
    rate: float,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """As ``behind_play``, from the derivatives of the bodies' torque at a sampling rate [Hz], (N, n)."""
    deltas = _deflections(matrices, rate, torque, width, stiffness, damping)
    return torque - of_bodies(matrices, deltas)


def play_columns(
    body: RigidBody, motion: Motion, torque: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """Torque that a little free play on each joint alone adds, per radian of it [N m/rad], shape (N, n, n).

    Entry (i, j) is that of joint i from play on joint j; of joints whose torque keeps its sign there is none.

    Args:
        body, motion, torque: as for ``behind_elasticity``.
        width: free play [rad or m], (n,).
    """
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    none = np.zeros(torque.shape[1])
    # a joint whose torque keeps its sign stays on one flank of its gear
    reverses = (torque.min(axis=0) < 0) & (torque.max(axis=0) > 0)
    deltas = _deflections(matrices, motion.rate, torque, width * reverses, none, none)
    pairs = zip(matrices, deltas, strict=True)
    return -sum(matrix * delta[:, None, :] for matrix, delta in pairs) / width


def _deflections(
    matrices: Matrices,
    rate: float,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> Matrices:
    """Delta of joints with free play and its first two derivatives by time, (N, n) each."""
    deltas = (np.zeros_like(torque), np.zeros_like(torque), np.zeros_like(torque))
    for j in np.flatnonzero(width):
        own = tuple(matrix[:, j, j] for matrix in matrices)
        followed = _one_joint(
            own, torque[:, j], rate, width[j], stiffness[j], damping[j]
        )
        for series, delta in zip(deltas, followed, strict=True):
            series[:, j] = delta
    return deltas


def _one_joint(
    own: tuple[np.ndarray, ...],
    torque: np.ndarray,
    rate: float,
    width: float,
    k: float,
    d: float,
) -> Matrices:
    """Delta of one joint with free play and its first two derivatives by time, (N,) each.

    Args:
        own: derivatives of its torque by its own position, velocity and acceleration, (N,) each.
        torque: that its bodies need [N m], (N,).
        rate: sampling rate [Hz].
        width: whole free play [rad].
        k, d: contact [N m/rad], [N m s/rad]; k is 0 if it is not known.
    """
    by_position, by_velocity, mass = own
    # bodies of no or negative mass, on the way of a search, are light ones here
    mass = np.maximum(mass, LIGHTEST)
    if not k:
        k = float(mass.mean()) * (2 * np.pi * CONTACT) ** 2
        d = 2 * CONTACT_DAMPING * float(np.sqrt(k * mass.mean()))
    parts = max(1, int(np.ceil(1.0 / (rate * LONGEST_STEP))))
    h, half = 1.0 / (rate * parts), 0.5 * width
    series = np.column_stack([mass, by_velocity, by_position, torque])
    m, c, g, push = finer(series, parts).T
    delta = _play(push, _OwnJoint(m, c, g, k, d), half, h)
    held = np.isfinite(delta).all() and np.abs(delta).max() <= half + FARTHEST
    if not held:
        delta = half * np.sign(push)
    return _with_rates(delta[::parts], 1.0 / rate)


def _with_rates(delta: np.ndarray, h: float) -> Matrices:
    """Delta (N,) with its first two derivatives by time, by central differences over samples h [s] apart."""
    rate = np.gradient(delta, h)
    acceleration = np.gradient(rate, h)
    # narrower, so that the upper end of the band is not damped
    acceleration[1:-1] = (delta[2:] - 2 * delta[1:-1] + delta[:-2]) / h**2
    return delta, rate, acceleration


class _OwnJoint(NamedTuple):
    """Coefficients of one joint's own equation, M delta'' + C delta' + G delta plus spring and damper, (N,) or numbers.

    Attributes:
        m, c, g: of the bodies [kg m^2], [N m s/rad], [N m/rad].
        k, d: of the contact [N m/rad], [N m s/rad].
    """

    m: np.ndarray
    c: np.ndarray
    g: np.ndarray
    k: float
    d: float


def _play(torque: np.ndarray, own: _OwnJoint, half: float, h: float) -> np.ndarray:
    """Delta (N,) of one joint with free play of half the width ``half`` [rad], by implicit steps of h [s]."""
    out = np.empty(len(torque))
    # numbers of Python are faster than those of arrays, and overflow without a word: see ``held``
    half, k, damper = float(half), float(own.k), float(own.d / h)
    flank = half if torque[0] > 0 else -half
    start = flank + float(torque[0]) / k
    now, before = start, start
    inertia = (own.m / h**2).tolist()
    drag = (own.c / h).tolist()
    inside = (own.m / h**2 + own.c / h + own.g).tolist()
    push = torque.tolist()
    contact = k + damper
    for i, floating in enumerate(inside):
        right = push[i] + inertia[i] * (2 * now - before) + drag[i] * now
        new = right / floating
        if new > half or new < -half:
            # beyond the play: the same step, with the contact on the flank that it meets
            flank = half if new > 0 else -half
            new = (right + k * flank + damper * now) / (floating + contact)
        before, now = now, new
        out[i] = new
    return out
