"""The environment where an arm runs away: noticed at once, explained, and kept from happening at random."""

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from episodes import NAME, SHORT, rollout

import gapscope  # noqa: F401 (registers the environment)
from gapscope.arm.robots import KNOWN_ROBOTS


def message(info: dict) -> str:
    return info["divergence"]["message"]


def test_divergence_is_noticed_at_once_and_explained(pendulum_urdf: Path) -> None:
    """Too large a step or gains; no torque limit and no damping; each with the arguments to change."""
    for bandwidth, step in ((200.0, 1e-3), (4.0, 20e-3)):
        _, _, info = rollout(
            bandwidth=bandwidth, time_step=step, sub_steps=round(0.02 / step), **SHORT
        )
        assert (
            info["terminated"]
            and "PD loop is unstable" in message(info)
            and "bandwidth" in message(info)
        )
        # the actions were zero
        assert "action_share" not in message(info)
    assert "time_step below" in message(info)
    push = np.ones(1, np.float32)
    _, rewards, info = rollout(
        push, robot=pendulum_urdf, action="torque", motion="fourier", action_share=100.0
    )
    assert info["terminated"] and info["divergence"]["joint"] == 1
    assert (
        "torque_limit" in message(info)
        and "viscous" in message(info)
        and np.isfinite(rewards).all()
    )
    assert "a smaller action_share" in message(info)
    assert info["divergence"]["speed"] > 50.0 and info["divergence"]["time"] < 0.05


@pytest.mark.parametrize("change", ["time_step", "bandwidth"])
def test_what_the_explanation_of_a_divergence_says_to_change_helps(change: str) -> None:
    options: dict = {"bandwidth": 4.0, "time_step": 20e-3, "sub_steps": 1}
    _, _, info = rollout(**options, **SHORT)
    value = float(re.search(rf"{change} below ([\d.e-]+)", message(info))[1])
    options |= {
        change: 0.9 * value
        if change == "time_step"
        else 0.9 * value * options["bandwidth"]
    }
    assert not rollout(**options, **SHORT)[2]["terminated"]


@pytest.mark.parametrize("action", ["residual", "torque"])
def test_an_action_that_diverges_earns_nothing_and_keeps_its_books(
    pendulum_urdf: Path, action: str
) -> None:
    """A posture kept by the encoders is no merit then; torque and its change are those of the steps done."""
    share = 1e4 if action == "residual" else 100.0
    options = {
        "robot": pendulum_urdf,
        "action": action,
        "action_share": share,
        "debug": True,
        **SHORT,
    }
    env = gym.make(NAME, **options).unwrapped
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.ones(1))
    assert terminated and info["divergence"]["speed"] > 50.0
    numbers = (
        reward,
        *(info[name] for name in ("tracking_rms", "torque_rate", "reward_effort")),
    )
    assert np.isfinite(numbers).all() and type(reward) is float and reward < 0
    assert info["reward_tracking"] == 0 and info["torque_rate"] > 0
    assert info["reward_effort"] == pytest.approx(-0.1 * share**2, rel=0.01)
    env.close()


@pytest.mark.parametrize("action", ["residual", "torque"])
@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
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
