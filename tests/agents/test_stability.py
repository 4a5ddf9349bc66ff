"""The gain margin by bisection, against a limit in closed form; and the arm that shakes."""

import numpy as np
import pytest

from gapscope.agents.controllers import Feedforward
from gapscope.agents.gains import Tuning, gains
from gapscope.agents.instability_demo import CASES, run_instability_demo
from gapscope.agents.stability import (
    HIGHEST,
    LOWEST,
    RESOLUTION,
    largest_factor,
    settles,
)
from gapscope.agents.tracking import SampledReference
from gapscope.arm.motions.point_to_point import PointToPoint
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm

DT = 1e-3


@pytest.mark.parametrize("limit", [0.1, 0.7, 1.0, 1.3, 3.7, 40.0])
def test_bisection_finds_a_limit(limit: float) -> None:
    calls: list[float] = []

    def stable(factor: float) -> bool:
        calls.append(factor)
        return factor <= limit

    assert limit / (1 + RESOLUTION) <= largest_factor(stable) <= limit
    assert len(calls) < 16


def test_bisection_without_a_limit_or_without_anything_stable() -> None:
    assert largest_factor(lambda factor: True) == HIGHEST
    assert largest_factor(lambda factor: False) == 0.0
    assert largest_factor(lambda factor: factor < 1.5 * LOWEST) >= LOWEST


@pytest.mark.parametrize("delay", [0.01, 0.03])
def test_margin_of_a_joint_with_a_delay(floating: NominalArm, delay: float) -> None:
    """L(s) = (w^2 + 2 zeta w s) exp(-s T) / s^2 has |L| = 1 at W = w sqrt(2 zeta^2 + sqrt(4 zeta^4 + 1)).

    Its limit is W T = atan(2 zeta W / w). To the delay come half a tick, for which the torque is held on average, and
    half a tick of the backward difference.
    """
    zeta = 0.7
    ratio = np.sqrt(2 * zeta**2 + np.sqrt(4 * zeta**4 + 1))
    limit = (
        np.arctan(2 * zeta * ratio)
        / ratio
        / (delay + 0.5 * DT + 0.5 * DT)
        / (2 * np.pi)
    )
    effects = (AppliedEffect("actuator_delay", (1,), {"delay": [delay]}),)
    course = SampledReference.of(
        PointToPoint(np.zeros(1), np.full(1, 0.3), 1.0), 2.0, DT, settle=0.0
    )
    with SimulatedArm(floating, effects, DT) as simulated:

        def stable(factor: float) -> bool:
            controller = Feedforward(
                gains(np.ones(1), Tuning(factor, zeta)), np.full(1, np.inf)
            )
            return settles(simulated, controller, course, cutoff=None)

        assert largest_factor(stable) == pytest.approx(limit, rel=0.05)


@pytest.mark.slow
def test_an_arm_with_a_wrong_model_inside_the_loop_shakes() -> None:
    found = {one.case: one.measures for one in run_instability_demo(iiwa())}
    assert tuple(found) == CASES
    right, wrong = found["computed, right model"], found["computed, wrong model"]
    assert right.joint_error < 1e-3 and wrong.joint_error > 0.01
    assert wrong.torque_rate > 50 * right.torque_rate
    beside = found[
        "feedforward, wrong model"
    ]  # outside the loop it only costs accuracy
    assert (
        beside.torque_rate < 2 * found["pd"].torque_rate
        and beside.joint_error > found["pd"].joint_error
    )
    assert found["feedforward, right model"].joint_error < 1e-3
