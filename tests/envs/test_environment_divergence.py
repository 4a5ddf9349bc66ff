"""The environment where an arm runs away: noticed at once, explained, and kept from happening at random."""

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from episodes import NAME, SHORT, rollout
from sweeps import daily

import gapscope  # noqa: F401 (registers the environment)
from gapscope.arm.robots import KNOWN_ROBOTS


def message(info: dict) -> str:
    return info["divergence"]["message"]


@pytest.mark.parametrize(
    ("options", "change"),
    [
        ({"bandwidth": 200.0, "time_step": 1e-3}, "bandwidth"),
        ({"bandwidth": 4.0, "time_step": 20e-3, "sub_steps": 1}, "bandwidth"),
        ({"bandwidth": 4.0, "time_step": 20e-3, "sub_steps": 1}, "time_step"),
    ],
)
def test_a_loop_that_is_too_fast_is_noticed_at_once_and_what_is_said_helps(
    options: dict, change: str
) -> None:
    """Too large a step or gains, with the arguments to change; the actions were zero."""
    _, _, info = rollout(**options, **SHORT)
    said = message(info)
    assert info["terminated"] and "PD loop is unstable" in said
    assert "action_share" not in said
    value = float(re.search(rf"{change} below ([\d.e-]+)", said)[1])
    # of the bandwidth it says a factor
    unit = 1.0 if change == "time_step" else options["bandwidth"]
    better = options | {change: 0.9 * value * unit}
    assert not rollout(**better, **SHORT)[2]["terminated"]


def test_an_action_without_a_limit_is_noticed_at_once_and_explained(
    pendulum_urdf: Path,
) -> None:
    """No torque limit and no damping."""
    options = {"action": "torque", "motion": "fourier", "action_share": 100.0}
    push = np.ones(1, np.float32)
    _, rewards, info = rollout(push, robot=pendulum_urdf, **options)
    assert info["terminated"] and info["divergence"]["joint"] == 1
    for words in ("torque_limit", "viscous", "a smaller action_share"):
        assert words in message(info)
    assert np.isfinite(rewards).all()
    assert info["divergence"]["speed"] > 50.0 and info["divergence"]["time"] < 0.05


@pytest.mark.parametrize(("action", "share"), [("residual", 1e4), ("torque", 100.0)])
def test_an_action_that_diverges_earns_nothing_and_keeps_its_books(
    pendulum_urdf: Path, action: str, share: float
) -> None:
    """A posture kept by the encoders is no merit then; torque and its change are those of the steps done."""
    options = {"action": action, "action_share": share, "debug": True, **SHORT}
    env = gym.make(NAME, robot=pendulum_urdf, **options).unwrapped
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.ones(1))
    assert terminated and info["divergence"]["speed"] > 50.0
    assert type(reward) is float and -np.inf < reward < 0
    assert np.isfinite(info["tracking_rms"]) and info["reward_tracking"] == 0
    assert 0 < info["torque_rate"] < np.inf
    assert info["reward_effort"] == pytest.approx(-0.1 * share**2, rel=0.01)
    env.close()


@pytest.mark.parametrize("action", ["residual", "torque"])
@pytest.mark.parametrize("robot", daily(KNOWN_ROBOTS, "kuka_iiwa"))
@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_random_actions_do_not_make_an_arm_run_away(robot: str, action: str) -> None:
    """With the whole torque a joint may come to its stop before 20 actions are over; with a residual none does."""
    env = gym.make(NAME, robot=robot, action=action)
    for seed in range(5):
        env.reset(seed=seed)
        env.action_space.seed(seed)
        for _ in range(25):
            _, reward, terminated, _, info = env.step(env.action_space.sample())
            assert "divergence" not in info and np.isfinite(reward)
            if terminated:
                assert action == "torque" and "limit" in info
                break
    env.close()
