"""The simulated arm on PyBullet against pinocchio, conservation laws and hand-worked cases."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.effects.applied import AppliedEffect
from gapscope.envs.simulated_arm import SimulatedArm


def test_friction_stops_a_moving_joint_and_never_turns_it_round(pendulum) -> None:
    """0.55 kg m^2 at 1 rad/s against 11 N m without gravity: stops after 0.05 s and 0.025 rad, and stays."""
    arm = replace(pendulum(coulomb=11.0), gravity=np.zeros(3))
    with SimulatedArm(arm) as engine:
        engine.reset(np.zeros(1), np.ones(1))
        path = []
        for _ in range(200):
            engine.step(np.zeros(1))
            path.append((float(engine.q[0]), float(engine.dq[0])))
    position, speed = np.array(path).T
    assert speed.min() > -1e-9 and np.abs(speed[51:]).max() < 1e-9
    assert position[-1] == pytest.approx(0.025, abs=6e-4)


@pytest.mark.parametrize(
    ("torque", "moves"), [(19.0, 0), (20.2, 1), (7.0, 0), (6.0, -1)]
)
def test_load_friction_sticks_up_to_its_share_of_the_motor_torque(
    pendulum, torque: float, moves: int
) -> None:
    """mu = 0.5 under a gravity torque of 9.81 N m: up beyond 9.81 / (1 - mu), down below 9.81 / (1 + mu) N m."""
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.5]})
    with SimulatedArm(pendulum(), (friction,)) as engine:
        for _ in range(100):
            engine.step(np.array([-torque]))
        assert (-np.sign(engine.q[0]) if abs(engine.q[0]) > 1e-6 else 0) == moves
