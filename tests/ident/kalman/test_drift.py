"""Friction that warms up: followed by the filter, and its time constant."""

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.kalman.drift import fit_warming
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.model.linear_problem import Problem

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


def test_amplitude_and_time_constant_are_recovered(warming, world):
    problem, t, noise = warming
    found = fit_warming(problem, t, ("b2", "c2"), noise)
    deviation = np.sqrt(np.diag(found.covariance))
    assert found.time_constant == pytest.approx(CONSTANT, rel=0.15)
    assert found.amplitude == pytest.approx(AMPLITUDE, rel=0.1)
    assert abs(found.time_constant - CONSTANT) < 4 * deviation[1]
    assert found.warm == pytest.approx(
        [world.arm.viscous[1], world.arm.coulomb[1]], rel=0.1
    )
    assert found.warnings == ()


def test_a_drift_slower_than_the_record_is_doubtful():
    rng, t = np.random.default_rng(0), np.arange(400) / 20
    v = np.sin(2 * t)
    tau = v * (1 + 0.5 * np.exp(-t / 80)) + 0.01 * rng.standard_normal(400)
    problem = Problem(
        v[:, None, None], tau[:, None], ("b1",), np.zeros(400, dtype=int), 0.05
    )
    found = fit_warming(problem, t, ("b1",), np.array([0.01]))
    assert any("record for longer" in warning for warning in found.warnings)


def test_an_unknown_parameter_is_named(warming):
    problem, t, noise = warming
    with pytest.raises(InputError, match="b9 is no parameter"):
        fit_warming(problem, t, ("b9",), noise)
