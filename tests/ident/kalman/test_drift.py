"""Friction that warms up, followed by the filter."""

import numpy as np
import pytest

from gapscope.effects.applied import AppliedEffect
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.kalman.recursive import Recursive

AMPLITUDE, CONSTANT = 0.8, 8.0


@pytest.fixture(scope="module")
def warming(world):
    """Thirty seconds of an arm whose second joint warms up: problem, times and noise."""
    drift = AppliedEffect(
        "friction_drift", (2,), {"amplitude": [AMPLITUDE], "time_constant": [CONSTANT]}
    )
    recording = world.recorded(5, effects=(drift,), duration=30.0)
    problem = world.assembly([recording])
    return (
        problem,
        world.assembly.times(recording),
        WeightedLeastSquares().estimate(problem).residual,
    )


def test_the_filter_follows_friction_that_warms_up(warming, world):
    problem, t, noise = warming
    track = Recursive(noise, drift={"b2": 0.5, "c2": 0.3}).follow(problem, t).smoothed()
    value, deviation = track.of("b2")
    truth = world.arm.viscous[1] * (1 + AMPLITUDE * np.exp(-t / CONSTANT))
    assert np.mean(np.abs(value - truth) < 1.96 * deviation) > 0.9
    assert np.abs(value - truth)[(t > 2) & (t < 28)].max() < 0.15 * truth.max()
