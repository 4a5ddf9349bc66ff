"""Synthetic recordings with joint torque sensors behind the gears; nothing of ``effects``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import synthetic
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.motions.trajectory import Fourier

ZERO = np.array([0.4, -0.6, 0.2])
"""What the sensors read without load [N m]."""
SCALE = np.array([0.01, -0.008, 0.005])
"""Error of their scales [1]."""
NOISE = np.array([0.2, 0.3, 0.1])
"""White noise of their readings, standard deviation [N m]."""


def reading(truth: Truth, motion: Fourier, t: np.ndarray) -> np.ndarray:
    """Torque behind the gears at times t [N m], (N, n), by pinocchio: bodies, springs, a force from outside."""
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    torque = synthetic.of_bodies(truth, q, dq, ddq)
    torque += np.array(truth.spring) * (q - truth.rest)
    return torque - (synthetic.pushed(truth, t, q) if any(truth.force) else 0.0)


def case(
    truth: Truth, *, on_link: Truth | None = None, seed: int = 2, duration: float = 8.0
) -> Case:
    """Three recordings with sensors, which read an arm with ``on_link``, or else that with ``truth``."""
    plain = synthetic.case(truth, seed, duration=duration)
    rng = np.random.default_rng(3000 + seed)
    told = []
    for k, recording in enumerate(plain.recordings):
        motion = synthetic.motion(10 * seed + k, (0.1, 0.2, 0.3)[k], duration)
        link = reading(on_link or truth, motion, recording.t)
        sensor = (1.0 + SCALE) * link + ZERO + NOISE * rng.standard_normal(link.shape)
        told.append(replace(recording, tau_sensor=sensor))
    return replace(plain, recordings=tuple(told))
