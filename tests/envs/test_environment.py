"""The environment: Gymnasium's contract, tracking, effects, rewards, endings and bad arguments."""

import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from arms import Link, written
from episodes import NAME, SHORT, rollout
from guard import HANG
from sweeps import daily

import gapscope  # noqa: F401 (registers the environment)
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import MOTIONS
from gapscope.arm.motions.trajectory import point_to_point
from gapscope.arm.robots import KNOWN_ROBOTS
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.actions import ACTION_KINDS
from gapscope.envs.environment import ArmTracking
from gapscope.envs.reward import Reward

ROOT = Path(__file__).parents[2]
HERE, THERE = np.zeros(7), np.full(7, 0.1)
COULOMB = AppliedEffect("coulomb_friction", (1, 4), {"torque": [3.0, 2.0]})


def errors(observations: np.ndarray, n: int = 7) -> np.ndarray:
    return observations[:, 2 * n : 3 * n]


@pytest.mark.parametrize(
    "options", [{}, {"action": "torque"}, {"effects": (COULOMB,), "debug": True}]
)
def test_gymnasium_checker_passes(
    options: dict, recwarn: pytest.WarningsRecorder
) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(gym.make(NAME, **SHORT, **options).unwrapped)
    assert [str(w.message) for w in recwarn if "gymnasium" in str(w.filename)] == []


@pytest.mark.parametrize("action", daily(ACTION_KINDS, "residual"))
def test_stable_baselines_checker(
    action: str, recwarn: pytest.WarningsRecorder
) -> None:
    name = "stable_baselines3.common.env_checker"
    checker = pytest.importorskip(name, reason="needs the extra learn")
    recwarn.clear()
    env = gym.make(NAME, action=action, **SHORT)
    checker.check_env(env)
    env.close()
    assert [str(w.message) for w in recwarn] == []


def test_made_by_name_without_an_import() -> None:
    code = f"import gymnasium as gym; env = gym.make('gapscope:{NAME}', episode_length=0.1); "
    code += "env.reset(); print(env.spec.id)"
    run = {"capture_output": True, "text": True, "timeout": HANG, "cwd": ROOT}
    done = subprocess.run([sys.executable, "-c", code], **run)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith(NAME)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("robot", daily(KNOWN_ROBOTS, "kuka_iiwa"))
def test_pd_with_nominal_feedforward_tracks(robot: str, motion: str) -> None:
    """Without effects and with zero action the arm keeps within 3 mrad of every motion."""
    how = {"motion": motion, "episode_length": 2.0, "engine": "pybullet"}
    observations, rewards, info = rollout(robot=robot, **how)
    assert np.abs(errors(observations, 6 if robot == "xarm6" else 7)).max() < 3e-3
    assert rewards.min() > 0.9 and not info["terminated"]


def test_the_loop_does_not_take_the_filters_lag_for_an_error() -> None:
    how = {"motion": "fourier", "bandwidth": 4.0, "episode_length": 2.0}
    off = errors(rollout(seed=1, **how)[0])
    assert np.sqrt(np.mean(off**2, axis=1)).max() < 3e-4


MJCF = """<mujoco model="two_rods"><compiler angle="radian"/>
<default><joint damping="0.3" armature="0.1" frictionloss="0.2"/></default>
<worldbody><body name="upper"><inertial pos="0 0 0.2" mass="2" diaginertia="0.1 0.1 0.02"/>
<joint name="shoulder" axis="0 1 0" range="-2 2"/><body name="lower" pos="0 0 0.4">
<inertial pos="0 0 0.15" mass="1" diaginertia="0.05 0.05 0.01"/><joint name="elbow" axis="0 1 0"/>
</body></body></worldbody></mujoco>"""


def test_an_arm_from_an_mjcf_file(tmp_path: Path) -> None:
    """It tracks as an arm from a URDF does."""
    (tmp_path / "arm.xml").write_text(MJCF)
    observations, _, info = rollout(robot=tmp_path / "arm.xml", episode_length=2.0)
    assert np.abs(errors(observations, 2)).max() < 3e-3 and not info["terminated"]


def test_reward_by_hand() -> None:
    """Errors of one tolerance on both joints give 1/2; half the rated torque 0.1 / 4; a jump of one 0.05."""
    parts = Reward()(np.array([0.01, -0.01]), 0.25, np.array([1.0, 1.0]))
    assert parts == pytest.approx((0.5, -0.025, -0.05))
    assert parts.total == pytest.approx(0.425)


@pytest.mark.parametrize("debug", [False, True])
def test_info_holds_the_parts_and_the_truth_only_for_debugging(debug: bool) -> None:
    env = gym.make(NAME, debug=debug, effects=(COULOMB,), action="torque", **SHORT)
    _, start = env.reset(seed=0)
    _, reward, _, _, info = env.step(np.full(7, 0.1, np.float32))
    parts = [info[f"reward_{part}"] for part in ("tracking", "effort", "smoothness")]
    assert type(reward) is float and reward == pytest.approx(sum(parts))
    assert parts[1:] == pytest.approx([-0.1 * 0.01, -0.05 * 0.01])
    assert info["tracking_rms"] > 0
    shown = {"torque_applied", "q_true"} & info.keys() | {"effects"} & start.keys()
    assert len(shown) == (3 if debug else 0)
    expected = 0.1 * env.unwrapped.torque_scale
    for name in ("torque_commanded", "torque_applied") if debug else ():
        np.testing.assert_allclose(info[name], expected, rtol=1e-6)
    env.close()


def test_observation_holds_what_its_layout_says() -> None:
    options = {"look_ahead": (0.02, 0.1), "action_share": 0.05, "motion": "fourier"}
    env = gym.make(NAME, **options).unwrapped
    rows = [env.reset(seed=1)[0]]
    rows += [env.step(np.full(7, 0.5, np.float32))[0] for _ in range(100)]
    env.close()
    table = np.array(rows, dtype=float)
    part = {name: table[:, where] for name, where in env.layout.slices.items()}
    q, ahead, goal = part["position"], part["look_ahead"], part["reference"]
    np.testing.assert_allclose(part["error"], goal - q, atol=1e-6)
    np.testing.assert_allclose(ahead[:-1, :7], np.diff(goal, axis=0), atol=1e-6)
    np.testing.assert_allclose(ahead[:-5, 7:], goal[5:] - goal[:-5], atol=1e-6)
    np.testing.assert_array_equal(part["action"], [[0.0] * 7] + [[0.5] * 7] * 100)
    # the estimate lags by about 4 ms
    slope, rate = (q[2:] - q[:-2]) / 0.04, part["velocity"]
    late = 0.5 * (rate[1:-1] + rate[2:])
    np.testing.assert_allclose(late[20:], slope[20:], atol=0.08)
    assert np.abs(part["feedforward"]).max() > 0.01


def test_a_motion_of_ones_own_and_options_for_one_episode() -> None:
    to, back = (point_to_point(*ends, 0.3) for ends in ([HERE, 3 * THERE], [THERE, HERE]))  # fmt: skip
    env = gym.make(NAME, motion=to, episode_length=0.4)
    where = env.unwrapped.layout.slices["reference"]
    np.testing.assert_allclose(env.reset(seed=0)[0][where], 0.0)
    start, _ = env.reset(options={"motion": back, "effects": (COULOMB,)})
    np.testing.assert_allclose(start[where], 0.1, atol=1e-7)
    assert env.unwrapped.effects == (COULOMB,)
    env.reset()
    assert env.unwrapped.effects == ()
    with pytest.raises(InputError, match="did you mean 'motion'"):
        env.reset(options={"motions": to})
    env.close()


@pytest.mark.parametrize("noise", [1e-3, [0, 1e-3, 0, 2e-3, 0, 0, 0]], ids=str)
def test_noise_of_the_encoders_has_its_size_and_comes_from_the_seed(
    noise: float | list[float],
) -> None:
    options = {"motion": "fourier", "episode_length": 2.0, "debug": True}
    env = ArmTracking(encoder_noise=noise, effects=(COULOMB,), **options)

    def readings(seed: int | None) -> np.ndarray:
        rows, truth = [], []
        observation, info = env.reset(seed=seed)
        for _ in range(100):
            rows.append(observation[:7])
            truth.append(info["q_true"])
            observation, _, _, _, info = env.step(np.zeros(7))
        return np.array(rows) - np.array(truth)

    first, other, again = readings(3), readings(None), readings(3)
    env.close()
    expected = np.broadcast_to(noise, 7)
    np.testing.assert_allclose(first.std(axis=0), expected, rtol=0.25, atol=1e-6)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_joint_at_its_stop_ends_the_episode() -> None:
    """What is told is the encoder's reading, which is off by 0.3 rad, and not the truth."""
    off = AppliedEffect("encoder_offset", tuple(range(1, 8)), {"offset": 0.3})
    options = {"action": "torque", "motion": "fourier", "debug": True}
    observations, _, info = rollout(effects=(off,), **options)
    said = r"joint (\d).*came to its stop.*its encoder reads (\S+) rad"
    number, read = re.search(said, info["limit"]).groups()
    joint, read = int(number) - 1, float(read)
    assert read == pytest.approx(observations[-1, joint], abs=1e-3)
    assert read == pytest.approx(info["q_true"][joint] + 0.3, abs=1e-3)


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("-3 3 99 9", r"reads \S+ m$"),
        ("-900 900 9e5 9", r"(?s)\d m/s after.* in N s/m"),
    ],
)
def test_early_ends_of_a_joint_that_slides_are_told_in_metres(
    tmp_path: Path, limit: str, said: str
) -> None:
    rail = Link("rail", "cart", kind="prismatic", limit=limit)
    robot = written(tmp_path / "robot.urdf", "r", rail)
    _, _, info = rollout(np.ones(1, np.float32), robot=robot, action="torque")
    told = info.get("limit") or info["divergence"]["message"]
    assert re.search(said, told) and "rad" not in told


def test_stepping_on_after_the_end_is_refused() -> None:
    env = ArmTracking(episode_length=0.02)
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded):
            env.step(np.zeros(7))
        env.reset(seed=0)
        assert env.step(np.zeros(7))[3]
    env.close()


def test_the_example_of_the_documentation_runs(capsys: pytest.CaptureFixture) -> None:
    text = (ROOT / "docs/environment.md").read_text(encoding="utf-8")
    example = text.split("```python\n")[1].split("```")[0]
    assert len(example.strip().splitlines()) <= 20
    exec(compile(example, "docs/environment.md", "exec"), {})
    assert "mrad" in capsys.readouterr().out
