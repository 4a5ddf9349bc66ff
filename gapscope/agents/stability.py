"""The largest gains with which an arm stays stable, by bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.agents.controllers import TrackingController
from gapscope.agents.tracking import SampledReference, track
from gapscope.envs.position_controller import VELOCITY_CUTOFF
from gapscope.envs.simulated_arm import SimulatedArm

KICK = 0.2
"""Velocity of all joints at the start of one of two runs [rad/s]."""
MAX_REMAINDER = 0.25
"""A loop is stable if less than this share of the kick is left at the end [1]."""
SPAN = 0.01
"""Time over which the speed of two runs is compared, long beside a step of the encoders [s]."""
LOWEST, HIGHEST = 1 / 16, 64.0
"""Factors on the bandwidth between which the margin is sought [1]."""
RESOLUTION = 0.02
"""The bisection ends when its interval is this narrow [1]."""


def settles(
    simulated: SimulatedArm,
    controller: TrackingController,
    course: SampledReference,
    cutoff: float | None = VELOCITY_CUTOFF,
) -> bool:
    """Whether an arm forgets a kick while it moves: two runs, one with a kick, come together again.

    Two runs of one course differ by the loop alone, whatever feedforward and tracking error. The difference of
    their speeds, RMS over the last third and largest over the joints, has to fall below ``MAX_REMAINDER`` of the kick.
    Two arms that shake between their torque limits may fall into step, so the speed of either's tracking error has to
    stay below the kick as well; better, lift the limits. Arms without noise only.
    """
    calm = track(simulated, controller, course, cutoff=cutoff)
    kicked = track(simulated, controller, course, kick=KICK, cutoff=cutoff)
    if calm.diverged or kicked.diverged:
        return False
    ticks = max(1, round(SPAN / simulated.dt))

    def final_speed(way: np.ndarray) -> float:
        rate = (way[ticks:] - way[:-ticks]) / (ticks * simulated.dt)
        last_third = rate[-len(rate) // 3 :]
        return float(np.sqrt(np.mean(last_third**2, axis=0)).max())

    forgotten = final_speed(kicked.q - calm.q) < MAX_REMAINDER * KICK
    errors = (calm.q - calm.q_ref, kicked.q - kicked.q_ref)
    return forgotten and max(map(final_speed, errors)) < KICK


def largest_factor(stable: Callable[[float], bool]) -> float:
    """Largest factor f for which ``stable(f)`` holds, by doubling or halving from 1 and then bisection of log f.

    A loop that is stable at f is assumed stable below; within ``LOWEST`` (0 is returned if not even
    that is stable) and ``HIGHEST``, which is returned if all are stable.
    """
    low, high = (1.0, 2.0) if stable(1.0) else (0.5, 1.0)
    if low == 1.0:
        while stable(high):
            low, high = high, 2 * high
            if low >= HIGHEST:
                return low
    else:
        while not stable(low):
            low, high = low / 2, low
            if low < LOWEST:
                return 0.0
    while high / low > 1 + RESOLUTION:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
