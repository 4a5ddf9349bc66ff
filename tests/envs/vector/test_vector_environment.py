"""The vector environment: N environments that do, bit by bit, what each does alone."""

from __future__ import annotations

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from own_effects import RECORDS, on_arm
from sweeps import daily

import gapscope  # noqa: F401 (makes the environment known)
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.severity import draw
from gapscope.envs.engines import ENGINES
from gapscope.envs.environment import ArmTracking, VectorArmTracking
from gapscope.envs.randomisation import Randomisation

NAME = "gapscope/ArmTracking-v0"
ALONE = ("joint_elasticity", "backlash")
"""Effects with which an arm is not stepped beside others."""
TOGETHER = tuple(name for name in CATALOGUE if name not in ALONE)


Pair = tuple[SyncVectorEnv, VectorArmTracking]


def _pair(
    arm: NominalArm | str,
    count: int,
    mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    **options: object,
) -> Pair:
    """Environments one by one, and the same together."""
    short = {"engine": "mujoco", "episode_length": 0.16, "motion": "fourier"}
    options = short | {"debug": True} | options
    single = [lambda: ArmTracking(arm, **options)] * count
    together = VectorArmTracking(count, arm, autoreset_mode=mode, **options)
    return SyncVectorEnv(single, autoreset_mode=mode), together


def _alike(pair: Pair, steps: int, size: float = 1.0, **options: object) -> int:
    """Assert that both are equal under random actions; returns how many episodes ended."""
    rng, ended = np.random.default_rng(1), 0
    starts = [env.reset(seed=5, options=options or None) for env in pair]
    assert data_equivalence(*starts, exact=True)
    for _ in range(steps):
        actions = size * rng.uniform(-1, 1, pair[1].action_space.shape)
        results = [env.step(actions.astype(np.float32)) for env in pair]
        assert data_equivalence(*results, exact=True)
        ended += int((results[0][2] | results[0][3]).sum())
    return ended


def _compare(
    arm: NominalArm | str,
    *,
    count: int = 3,
    steps: int = 12,
    size: float = 1.0,
    **options: object,
) -> int:
    """The same, of environments of their own."""
    pair = _pair(arm, count, **options)
    ended = _alike(pair, steps, size)
    for env in pair:
        env.close()
    return ended


@pytest.mark.parametrize(
    ("action", "mode"),
    [
        ("residual", AutoresetMode.NEXT_STEP),
        ("scale", AutoresetMode.SAME_STEP),
        ("gains", AutoresetMode.NEXT_STEP),
        ("torque", AutoresetMode.SAME_STEP),
    ],
)
def test_equal_to_single_environments_with_effects_drawn(
    data_sheet_arm: NominalArm, action: str, mode: AutoresetMode
) -> None:
    drawn = Randomisation(TOGETHER, count=(0, 4))
    size = 0.2 if action == "torque" else 1.0
    options = {"action": action, "size": size, "mode": mode, "count": 4}
    assert _compare(data_sheet_arm, randomisation=drawn, **options) >= 4


@pytest.fixture(scope="module")
def pair(data_sheet_arm: NominalArm) -> Iterator[Pair]:
    made = _pair(data_sheet_arm, 2)
    yield made
    for env in made:
        env.close()


@pytest.mark.parametrize("name", TOGETHER)
def test_equal_to_single_environments_with_each_effect(
    data_sheet_arm: NominalArm, pair: Pair, name: str
) -> None:
    scale = ArmScale.of(data_sheet_arm)
    effect = draw(name, np.random.default_rng(7), scale, joints=(2, 4))
    _alike(pair, steps=4, effects=(effect,))


def test_equal_without_friction_with_noise_on_a_hand_and_on_joints_in_another_order(
    bare_arm: NominalArm,
) -> None:
    noise = {"encoder_noise": 1e-4, "steps": 6}
    _compare(bare_arm, action="torque", size=0.05, **noise)
    _compare("franka_panda", **noise)
    joints, dry = tuple(reversed(bare_arm.joints[:5])), np.full(5, 0.5)
    backwards = NominalArm("part", bare_arm.urdf, joints, coulomb=dry)
    _compare(backwards, steps=6)


@pytest.mark.parametrize("action", ["residual", "torque"])
def test_arms_that_diverge_end_alone(bare_arm: NominalArm, action: str) -> None:
    options = {"action": action, "action_share": 30.0, "episode_length": 1.0}
    assert _compare(bare_arm, steps=6, **options) > 0


def test_drift_of_held_and_of_delayed_torque(data_sheet_arm: NominalArm) -> None:
    """Drift is taken over before or after the torque, depending on whether that changes within an action."""
    drift = {"amplitude": 0.8, "time_constant": 0.1}
    warm = AppliedEffect("friction_drift", (1, 2, 3), drift)
    load = AppliedEffect("load_friction", (1, 2, 3), {"coefficient": 0.2})
    late = AppliedEffect("actuator_delay", (2,), {"delay": 2.3e-3})
    for effects in ((warm, load), (warm, load, late)):
        _compare(data_sheet_arm, effects=effects, action="torque", size=0.2)


def test_equal_with_effects_of_a_user_that_differ_between_arms(
    own: None, data_sheet_arm: NominalArm
) -> None:
    """Each arm has two of them, and others at the next reset."""
    effects = [on_arm(name) for name in RECORDS]
    count, still = len(effects), np.zeros((len(effects), 7), np.float32)
    options = {"episode_length": 0.16, "encoder_noise": 1e-4}
    alone = ArmTracking(data_sheet_arm, engine="mujoco", **options)
    together = VectorArmTracking(count, data_sheet_arm, **options)
    for shift in (1, 2):
        pairs = [(effect, effects[i - shift]) for i, effect in enumerate(effects)]
        each = [{"effects": pair} for pair in pairs]
        seen = [together.reset(seed=5, options={"each": each})[0]]
        seen += [together.step(still)[0] for _ in range(6)]
        for i in range(count):
            single = [alone.reset(seed=5 + i, options=each[i])[0]]
            single += [alone.step(still[i])[0] for _ in range(6)]
            np.testing.assert_array_equal(single, np.array(seen)[:, i])


def test_made_by_name(data_sheet_arm: NominalArm) -> None:
    made = gym.make_vec(NAME, num_envs=3, robot=data_sheet_arm, episode_length=0.1)
    assert isinstance(made.unwrapped, VectorArmTracking)
    assert made.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    observations, _ = made.reset(seed=0)
    assert observations in made.observation_space
    after, rewards, _, _, infos = made.step(made.action_space.sample())
    assert after in made.observation_space and rewards.shape == (3,)
    assert infos["_reward_tracking"].all()
    made.close()


def test_options_for_each_environment(data_sheet_arm: NominalArm) -> None:
    payload = AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.1]})
    env = VectorArmTracking(2, data_sheet_arm, episode_length=0.1)
    env.reset(seed=np.int64(0), options={"each": [{"effects": payload}, {}]})
    assert [len(effects) for effects in env.effects] == [1, 0]
    with pytest.raises(InputError, match="expected 2, one for each environment"):
        env.reset(options={"each": [{}]})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"render_mode": "rgb_array"}, "draws nothing"),
        ({"autoreset_mode": "Disabled"}, "expected NextStep or SameStep"),
        ({"num_envs": 0}, "whole number from 1 on"),
        ({"threads": -1}, "whole number from 0 on"),
        ({"threads": 1.5}, "whole number from 0 on"),
    ],
)
def test_what_it_does_not_do_is_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        VectorArmTracking(**{"num_envs": 2, **options})


@pytest.fixture
def two_masses(data_sheet_arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """Effects that give a joint a motor of its own."""
    rng, scale = np.random.default_rng(7), ArmScale.of(data_sheet_arm)
    return tuple(draw(name, rng, scale, joints=(2, 4)) for name in ALONE)


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_arms_stepped_one_by_one_are_equal_too(
    engines, two_masses: tuple, data_sheet_arm: NominalArm, engine: str
) -> None:
    drawn = Randomisation((*ALONE, "payload"), count=(0, 2))
    how = {"engine": engines(engine), "steps": 10, "count": 2}
    for options in ({"effects": two_masses}, {"randomisation": drawn}):
        _compare(data_sheet_arm, **how, **options)


def test_motors_of_their_own_come_when_the_environments_are_made(
    two_masses: tuple, data_sheet_arm: NominalArm
) -> None:
    env = VectorArmTracking(2, data_sheet_arm)
    with pytest.raises(InputError, match="not stepped together") as caught:
        env.reset(seed=0, options={"effects": two_masses[0]})
    assert "sync" in caught.value.remedy


def test_threads_do_not_change_the_result(data_sheet_arm: NominalArm) -> None:
    rows, options = [], {"episode_length": 0.1, "motion": "fourier"}
    for threads in (1, 2):
        env = VectorArmTracking(5, data_sheet_arm, threads=threads, **options)
        env.reset(seed=3)
        action = np.full(env.action_space.shape, 0.5, np.float32)
        rows.append([env.step(action)[0] for _ in range(4)])
    np.testing.assert_array_equal(*rows)
