"""The sampled controller: encoders, velocity filter, PD law with feedforward; compiled by numba."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.blind_check.generator.joint import MAX_JOINTS, njit

FILTER = np.dtype([(name, "f8", (MAX_JOINTS,)) for name in ("x1", "x2", "y1", "y2")])
"""Memory of the velocity filter: its inputs x and outputs y of the last two ticks."""


@dataclass(frozen=True)
class Loop:
    """A PD controller, n joints.

    Attributes:
        rate: [Hz].
        kp, kd: gains [N m/rad, N m s/rad], (n,).
        limit: largest command [N m], (n,).
        cutoff, damping: of the velocity filter s w^2 / (s^2 + 2 z w s + w^2) [Hz, 1].
        feedforward: ``none``, ``gravity`` or ``nominal``.
    """

    rate: float
    kp: np.ndarray
    kd: np.ndarray
    limit: np.ndarray
    cutoff: float
    damping: float
    feedforward: str

    def coefficients(self) -> np.ndarray:
        """b0, a1, a2 of the filter by Tustin's rule: y = b0 (x - x_-2) - a1 y_-1 - a2 y_-2."""
        w, k = 2 * np.pi * self.cutoff, 2.0 * self.rate
        a0 = k * k + 2 * self.damping * w * k + w * w
        b0 = k * w * w
        a1 = 2 * w * w - 2 * k * k
        a2 = k * k - 2 * self.damping * w * k + w * w
        return np.array([b0, a1, a2]) / a0


@njit(cache=True)
def encoder_reading(p, s, i, q, noise):  # type: ignore[no-untyped-def]
    """What the encoder of joint i reads [rad]: the motor's side of a compliant joint, offset, noisy and rounded."""
    true = s.theta[i] if p.stiffness[i] > 0.0 else q[i]
    x = true + p.encoder[i] * (1.0 + p.eccentric[i] * np.sin(true)) + noise[i]
    return np.round(x / p.step[i]) * p.step[i]


@njit(cache=True)
def filtered_velocity(m, i, filt, x):  # type: ignore[no-untyped-def]
    """Velocity of joint i [rad/s] from its reading x [rad]; moves the filter's memory."""
    y = filt[0] * (x - m.x2[i]) - filt[1] * m.y1[i] - filt[2] * m.y2[i]
    m.x2[i] = m.x1[i]
    m.x1[i] = x
    m.y2[i] = m.y1[i]
    m.y1[i] = y
    return y


@njit(cache=True)
def command(par, state, memory, filt, q, noise, q_ref, dq_ref, ahead, out, first):  # type: ignore[no-untyped-def]
    """One tick: what the encoders read, the filtered velocity, and the command; returns how many joints clipped.

    Args:
        par, state, memory: records of ``JOINT``, ``STATE`` and ``FILTER``, as arrays of length 1.
        filt: b0, a1, a2.
        q: of the links [rad], (n,).
        noise: of the encoders [rad], (n,).
        q_ref, dq_ref, ahead: reference [rad, rad/s] and feedforward [N m], (n,).
        out: rows q, dq, tau, (3, n), written to.
        first: whether this is the first tick.
    """
    p, s, m = par[0], state[0], memory[0]
    clipped = 0
    for i in range(p.n):
        x = encoder_reading(p, s, i, q, noise)
        if first:
            m.x1[i] = x
            m.x2[i] = x
        y = filtered_velocity(m, i, filt, x)
        u = ahead[i] + p.kp[i] * (q_ref[i] - x) + p.kd[i] * (dq_ref[i] - y)
        if abs(u) > p.limit[i]:
            clipped += 1
            u = p.limit[i] if u > 0 else -p.limit[i]
        out[0, i] = x
        out[1, i] = y
        out[2, i] = u
    return clipped
