"""A two-joint arm with a torque that no effect explains, and what is left of it."""

from __future__ import annotations

from functools import cache

import numpy as np
from cases import sines

from gapscope.arm.motions.motion import Motion
from gapscope.ident.residual.fit import (
    ResidualSettings,
    Trajectory,
    fit_residual,
)

RATE, DURATION, N = 100.0, 12.0, 2


def motion(seed: int, *, speed: float = 1.0) -> Motion:
    """A sum of sines on each joint."""
    rng, t = np.random.default_rng(seed), np.arange(int(RATE * DURATION)) / RATE
    parts = []
    for _ in range(3):
        w, size = speed * rng.uniform(0.8, 3.0, N), rng.uniform(0.2, 0.5, N)
        parts.append(sines(t, size, w, rng.uniform(0.0, 6.0, N)))
    return Motion(t, *(sum(getattr(p, x) for p in parts) for x in ("q", "dq", "ddq")))


def unknown(m: Motion) -> np.ndarray:
    """What no effect explains: on joint 1 a torque that depends on position and direction; nothing on joint 2."""
    torque = np.zeros_like(m.q)
    torque[:, 0] = np.sin(3.0 * m.q[:, 0]) * np.tanh(m.dq[:, 0] / 0.3)
    return torque


def trajectory(seed: int) -> Trajectory:
    """The unknown torque, noise, and an error of the friction that belongs to the effects."""
    m = motion(seed)
    own = np.stack([m.dq, np.tanh(m.dq / 0.05), m.ddq, np.ones_like(m.dq)], axis=2)
    columns = np.concatenate(
        [own[:, :, k, None] * np.eye(N) for k in range(own.shape[2])], axis=2
    )
    noise = 0.1 * np.random.default_rng(seed + 100).standard_normal(m.q.shape)
    left = unknown(m) + noise + 0.3 * np.tanh(m.dq / 0.05)
    rows = np.arange(30, len(m.t) - 30, 2)
    load = 5.0 * np.cos(m.q)
    return Trajectory(f"r{seed}", m, load, left, columns[rows], columns[rows], rows)


@cache
def trained(form: str = "additive") -> tuple:
    """A network trained on three trajectories, in a short training."""
    short = ResidualSettings(form=form, apart="all", members=3, hidden=16, steps=600)
    return fit_residual([trajectory(k) for k in range(3)], short)
