"""The environment where an arm runs away: noticed at once, explained, and kept from happening at random."""

import re
from pathlib import Path

import numpy as np
import pytest

gym = pytest.importorskip(
    "gymnasium", reason="the environment needs gymnasium, a dependency of the package"
)

from episodes import NAME, SHORT, rollout  # noqa: E402

import gapscope  # noqa: E402, F401 (registers the environment)
from gapscope.arm.control import feedforward  # noqa: E402
from gapscope.arm.motions.named_motions import MOTIONS, draw_motion  # noqa: E402
from gapscope.arm.robots import KNOWN_ROBOTS  # noqa: E402
from gapscope.arm.velocity_filter import VelocityFilter  # noqa: E402
from gapscope.effects.applied import carried  # noqa: E402
from gapscope.envs.actions import Control, Gains, torque_limit  # noqa: E402
from gapscope.envs.divergence import diverged, divergence_info, longest_step  # noqa: E402
from gapscope.envs.environment import ArmTracking  # noqa: E402
from gapscope.envs.position_controller import VELOCITY_DAMPING, cutoff  # noqa: E402


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


def test_a_speed_that_is_no_number_is_a_divergence_too(pendulum) -> None:
    """And a speed below the bound on every joint is none, whatever they come to together."""
    assert (
        diverged(np.array([0.0, np.nan]))
        and diverged(np.array([0.0, -50.1]))
        and diverged(np.array([np.inf]))
    )
    assert not diverged(np.full(7, 49.0))
    control = Control("torque", np.ones(1), np.ones(1), np.full(1, np.inf), None)
    setup = ArmTracking(pendulum(), **SHORT).setup._replace(control=control)
    told = divergence_info(setup, 100, np.zeros(1), np.array([np.nan]))
    assert "joint 1 diverged: a speed that is no number" in message(told)
    assert "actions drive it: a smaller action_share" in message(told)


def test_without_an_action_no_smaller_one_is_advised(pendulum) -> None:
    loose = Control("torque", np.ones(1), np.ones(1), np.full(1, np.inf), None)
    kind = loose._replace(kind="residual", gains=Gains(np.ones(1), np.ones(1)))
    load = (carried(1.0, (0.0, 0.0, 0.1)),)
    plain = ArmTracking(pendulum(), **SHORT).setup
    for control, said in ((loose, "nothing holds the arm"), (kind, "milder effects")):
        setup = plain._replace(control=control)
        fast = np.zeros(1), np.array([60.0])
        told = divergence_info(setup, 100, *fast, load, acted=False)
        assert said in message(told) and "smaller" not in message(told)


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


@pytest.mark.parametrize(
    ("kp", "kd", "viscous"), [(400.0, 8.0, 0.0), (400.0, 8.0, 5.0), (2000.0, 30.0, 0.0)]
)
def test_longest_stable_step_against_the_loop_itself(
    pendulum, kp: float, kd: float, viscous: float
) -> None:
    """A pushed joint under PD with the velocity estimate comes to rest a little below it, and not a little above."""
    arm, gains, mass = (
        pendulum(viscous=viscous),
        Gains(np.array([kp]), np.array([kd])),
        0.55,
    )
    loop = gains, np.array([[mass]]), arm.viscous
    longest = longest_step(*loop, 0.2)

    def last(dt: float) -> float:
        estimate = VelocityFilter(
            1 / dt, cutoff(1 / dt), VELOCITY_DAMPING, np.zeros(1), np.zeros(1)
        )
        q, dq = np.zeros(1), np.full(1, 1e-3)
        for _ in range(3000):
            torque = -kp * q - kd * estimate(q)
            dq = (mass * dq + dt * torque) / (mass + dt * viscous)
            q = q + dt * dq
        return float(np.abs(dq[0]))

    assert last(0.97 * longest) < 1e-5 and last(1.03 * longest) > 1.0
    assert longest_step(*loop, 0.97 * longest) == 0.97 * longest


def test_gains_that_no_step_holds() -> None:
    stiff = Gains(np.array([1e6]), np.array([1e4]))
    assert longest_step(stiff, np.array([[0.55]]), np.zeros(1), 1e-3) == 0.0


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


@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_an_action_of_one_carries_the_default_motions(robot: str) -> None:
    """The rated torque is no more than the limit, and more than gravity, friction and any motion drawn need."""
    env = ArmTracking(robot, action="torque")
    env.close()
    assert (env.torque_scale <= torque_limit(env.arm, env.body)).all()
    for motion in MOTIONS:
        for seed in range(4):
            drawn = draw_motion(motion, np.random.default_rng(seed), env.space, 5.0)
            t = np.arange(0.0, 5.0, 0.01)
            needed = feedforward(
                env.arm,
                env.body,
                "nominal",
                drawn.position(t),
                drawn.velocity(t),
                drawn.acceleration(t),
            )
            assert (np.abs(needed).max(axis=0) < 0.95 * env.torque_scale).all()
