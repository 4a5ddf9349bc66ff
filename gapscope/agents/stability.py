"""The largest gains with which an arm stays stable, by bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.agents.controllers import TrackingController
from gapscope.agents.tracking import SampledReference, track
from gapscope.envs.position_controller import VELOCITY_CUTOFF
from gapscope.envs.simulated_arm import SimulatedArm
from gapscope.model.torque_gap import torque_scale

KICK = 0.2
"""Velocity of all joints at the start of one of two runs [rad/s]."""
MAX_REMAINDER = 0.25
"""A loop is stable if less than this share of the kick is left at the end [1]."""
MAX_TORQUE_RATE = 10.0
"""An arm shakes if its torque changes so many times as fast as the motion needs [1]. Set by hand: arms that follow stay
below 2, those that shake between their torque limits are above 50 (``docs/feedforward.md``)."""
SPAN = 0.01
"""Time over which speeds and torque rates are taken, long beside a step of the encoders [s]."""
FACTORS = 2.0 ** np.arange(-4, 7)
LOWEST, HIGHEST = float(FACTORS[0]), float(FACTORS[-1])
"""Factors on the bandwidth between which the margin is sought [1]."""
RESOLUTION = 0.02
"""The bisection ends when its interval is this narrow [1]."""


def settles(
    simulated: SimulatedArm,
    controller: TrackingController,
    course: SampledReference,
    needed: np.ndarray,
    cutoff: float | None = VELOCITY_CUTOFF,
) -> bool:
    """Whether an arm forgets a kick while it moves: two runs, one with a kick, come together again.

    Two runs of one course differ by the loop alone, whatever feedforward and tracking error. The difference of
    their speeds, RMS over the last third and largest over the joints, has to fall below ``MAX_REMAINDER`` of the kick.
    Two arms that shake between their torque limits may fall into step: their torque rate tells them. How well the arm
    tracks does not count. Arms without noise only.

    Args:
        simulated: the arm.
        controller: with its feedforward, if it has one, in ``course``.
        course: what is tracked.
        needed: torque that the arm needs on the course [N m], shape (N, n).
        cutoff: of the velocity's differentiator [Hz]; a backward difference if ``None``.
    """
    calm = track(simulated, controller, course, cutoff=cutoff)
    kicked = track(simulated, controller, course, kick=KICK, cutoff=cutoff)
    if calm.diverged or kicked.diverged:
        return False
    ticks = max(1, round(SPAN / simulated.dt))

    def final_rate(series: np.ndarray) -> np.ndarray:
        rate = (series[ticks:] - series[:-ticks]) / (ticks * simulated.dt)
        last_third = rate[-len(rate) // 3 :]
        return np.sqrt(np.mean(last_third**2, axis=0))

    forgotten = final_rate(kicked.q - calm.q).max() < MAX_REMAINDER * KICK
    usual = np.diff(needed[::ticks], axis=0) / (ticks * simulated.dt)
    allowed = MAX_TORQUE_RATE * torque_scale(usual)
    shakes = any((final_rate(run.tau) > allowed).any() for run in (calm, kicked))
    return bool(forgotten and not shakes)


def largest_factor(stable: Callable[[float], bool]) -> float:
    """Largest factor f for which ``stable(f)`` holds, by halving or doubling from 1 and then bisection of log f.

    A loop that is stable at f is assumed stable below, down to the first stable one: gains may be too small to hold
    the arm. Sought between ``LOWEST`` and ``HIGHEST``, which is returned if it is stable; 0 if nothing is.
    """
    # from 1 downward, and only then upward
    order = sorted(FACTORS.tolist(), key=lambda f: (f > 1, abs(np.log2(f))))
    low = next((factor for factor in order if stable(factor)), 0.0)
    high = 2 * low
    if low >= 1.0:
        while low < HIGHEST and stable(high):
            low, high = high, 2 * high
    if low in (0.0, HIGHEST):
        return low
    while high / low > 1 + RESOLUTION:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
