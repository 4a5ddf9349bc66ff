"""What the integrator of a controller held when a recording with its torque began."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from gapscope.arm.control.control_loop import Targets
from gapscope.arm.controller import Controller
from gapscope.arm.recording import Recording

START = 0.5
"""Span from whose recorded torque the start of an integrator is taken [s]."""


def integral_at_start(
    recording: Recording, controller: Controller, targets: Targets
) -> np.ndarray:
    """Torque of the integrator at the first row [N m], (n,).

    The mean over ``START`` of what the law leaves of the recorded torque, less what the integrator has gained by then:
    the noise of one row would push light joints away.

    Args:
        recording: without gaps, with its torque.
        controller: a law with an integrator.
        targets: at its ticks from the first row on.
    """
    t = recording.t - recording.t[0]
    part = recording.part(t <= START)
    assert part.tau is not None
    target = targets.at((t[t <= START] * controller.rate + 1e-6).astype(int))
    dq = np.gradient(part.q, part.t, axis=0) if part.dq is None else part.dq
    error, rate = target.q - part.q, target.dq - dq
    slope = controller.integration(error, rate)
    gained = cumulative_trapezoid(slope, part.t, axis=0, initial=0)
    left = part.tau - target.torque - controller.proportional(error, rate) - gained
    mean: np.ndarray = left.mean(axis=0)
    return mean
