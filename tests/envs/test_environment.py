"""The environment: Gymnasium's contract, tracking, effects, rewards, endings and bad arguments."""

import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from episodes import NAME, SHORT, rollout
from guard import HANG

import gapscope  # noqa: F401 (registers the environment)
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import MOTIONS
from gapscope.arm.motions.trajectory import point_to_point
from gapscope.arm.robots import KNOWN_ROBOTS
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.envs.actions import ACTION_KINDS
from gapscope.envs.environment import ArmTracking
from gapscope.envs.reward import Reward

ROOT = Path(__file__).parents[2]
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


@pytest.mark.parametrize("action", ACTION_KINDS)
def test_stable_baselines_checker(
    action: str, recwarn: pytest.WarningsRecorder
) -> None:
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker", reason="needs the extra learn"
    )
    recwarn.clear()
    env = gym.make(NAME, action=action, **SHORT)
    checker.check_env(env)
    env.close()
    assert [str(w.message) for w in recwarn] == []


@pytest.mark.parametrize(
    "code",
    [
        "import gapscope, gymnasium as gym; name = ''",
        "import gymnasium as gym, gapscope; name = ''",
        "import gymnasium as gym; name = 'gapscope:'",
    ],
)
def test_made_by_name_with_and_without_an_import(code: str) -> None:
    code += f"\nenv = gym.make(name + {NAME!r}, episode_length=0.1); env.reset(); print(env.spec.id)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=HANG,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith(NAME)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
def test_pd_with_nominal_feedforward_tracks(robot: str, motion: str) -> None:
    """Without effects and with zero action the arm keeps within 3 mrad of every motion."""
    observations, rewards, info = rollout(
        robot=robot, motion=motion, episode_length=2.0, engine="pybullet"
    )
    assert np.abs(errors(observations, 6 if robot == "xarm6" else 7)).max() < 3e-3
    assert rewards.min() > 0.9 and not info["terminated"]


MJCF = """<mujoco model="two_rods"><compiler angle="radian"/>
<default><joint damping="0.3" armature="0.1" frictionloss="0.2"/></default>
<worldbody><body name="upper"><inertial pos="0 0 0.2" mass="2" diaginertia="0.1 0.1 0.02"/>
<joint name="shoulder" axis="0 1 0" range="-2 2"/><body name="lower" pos="0 0 0.4">
<inertial pos="0 0 0.15" mass="1" diaginertia="0.05 0.05 0.01"/><joint name="elbow" axis="0 1 0"/>
</body></body></worldbody></mujoco>"""


def test_an_arm_from_an_mjcf_file(tmp_path: Path) -> None:
    """Friction and rotors come with it, and it tracks as an arm from a URDF does."""
    (tmp_path / "arm.xml").write_text(MJCF)
    env = ArmTracking(tmp_path / "arm.xml")
    assert env.arm.joints == ("shoulder", "elbow") and env.arm.name == "two_rods"
    for values, expected in (
        (env.arm.armature, 0.1),
        (env.arm.coulomb, 0.2),
        (env.arm.viscous, 0.3),
    ):
        np.testing.assert_allclose(values, expected)
    env.close()
    observations, _, info = rollout(robot=tmp_path / "arm.xml", episode_length=2.0)
    assert np.abs(errors(observations, 2)).max() < 3e-3 and not info["terminated"]


EFFECTS = [
    COULOMB,
    AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.0, 0.1]}),
    AppliedEffect("torque_scale", (2, 4), {"scale": [-0.2, 0.15]}),
    AppliedEffect("actuator_delay", (1, 4), {"delay": 0.02}),
]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_effects_change_the_outcome(effect: AppliedEffect, tmp_path: Path) -> None:
    """An effect makes tracking worse, and is the same from records as from a corrected.yaml."""
    write_corrected("test", (effect,), tmp_path / "corrected.yaml")
    options = {"motion": "fourier", "episode_length": 2.0}
    clean, given, read = (
        rollout(effects=effects, **options)
        for effects in (None, (effect,), tmp_path / "corrected.yaml")
    )
    assert np.abs(errors(given[0])).max() > 1.5 * np.abs(errors(clean[0])).max()
    np.testing.assert_array_equal(given[0], read[0])


def test_dry_friction_sticks_without_chatter() -> None:
    """Pushed off its posture and let go, the arm comes to rest away from it, and for good."""
    posture = np.array([0.0, 0.73, 0.0, -1.62, 0.0, 0.57, 0.0])
    friction = AppliedEffect("coulomb_friction", tuple(range(1, 8)), {"torque": 2.0})
    stand = point_to_point(posture, posture, 1.0)
    options = {
        "feedforward": "gravity",
        "action_share": 1.0,
        "episode_length": 4.0,
        "debug": True,
    }
    env = gym.make(NAME, effects=(friction,), motion=stand, **options)
    env.reset(seed=0)
    speeds = []
    push = np.array([0.0, 12.0, 0.0, 12.0, 0.0, 0.0, 0.0]) / env.unwrapped.torque_scale
    for step in range(200):
        info = env.step((push * (step < 25)).astype(np.float32))[4]
        speeds.append(np.abs(info["dq_true"]).max())
    assert max(speeds[:25]) > 0.1 and max(speeds[150:]) < 1e-9
    assert np.abs(info["q_true"] - posture).max() > 1e-3
    env.close()


def test_reward_by_hand() -> None:
    """Errors of one tolerance on both joints give 1/2; half the rated torque 0.1 / 4; a jump of one 0.05."""
    parts = Reward()(np.array([0.01, -0.01]), 0.25, np.array([1.0, 1.0]))
    assert parts == pytest.approx((0.5, -0.025, -0.05))
    assert parts.total == pytest.approx(0.425)


def test_info_holds_the_parts_and_the_truth_only_for_debugging() -> None:
    for debug in (False, True):
        env = gym.make(NAME, debug=debug, effects=(COULOMB,), action="torque", **SHORT)
        _, start = env.reset(seed=0)
        _, reward, _, _, info = env.step(np.full(7, 0.1, np.float32))
        parts = [
            info[f"reward_{part}"] for part in ("tracking", "effort", "smoothness")
        ]
        assert reward == pytest.approx(sum(parts)) and info["tracking_rms"] > 0
        assert (
            type(reward) is float
            and parts[1] == pytest.approx(-0.1 * 0.01)
            and parts[2] == pytest.approx(-0.05 * 0.01)
        )
        assert (
            ("torque_applied" in info)
            == ("q_true" in info)
            == ("effects" in start)
            == debug
        )
        env.close()
    expected = 0.1 * env.unwrapped.torque_scale
    np.testing.assert_allclose(info["torque_commanded"], expected, rtol=1e-6)
    np.testing.assert_allclose(info["torque_applied"], expected, rtol=1e-6)


def test_observation_holds_what_its_layout_says() -> None:
    env = gym.make(
        NAME, motion="fourier", effects=None, look_ahead=(0.02, 0.1), action_share=0.05
    ).unwrapped
    observation, _ = env.reset(seed=1)
    rows = [observation]
    for _ in range(100):
        rows.append(env.step(np.full(7, 0.5, np.float32))[0])
    part = {
        name: np.array(rows, dtype=float)[:, where]
        for name, where in env.layout.slices.items()
    }
    np.testing.assert_allclose(
        part["error"], part["reference"] - part["position"], atol=1e-6
    )
    np.testing.assert_allclose(
        part["look_ahead"][:-1, :7], np.diff(part["reference"], axis=0), atol=1e-6
    )
    np.testing.assert_allclose(
        part["look_ahead"][:-5, 7:],
        part["reference"][5:] - part["reference"][:-5],
        atol=1e-6,
    )
    np.testing.assert_array_equal(part["action"], [[0.0] * 7] + [[0.5] * 7] * 100)
    slope = (part["position"][2:] - part["position"][:-2]) / 0.04
    late = (
        0.5 * (part["velocity"][1:-1] + part["velocity"][2:])[20:]
    )  # the estimate lags by about 4 ms
    np.testing.assert_allclose(late, slope[20:], atol=0.08)
    assert np.abs(part["feedforward"]).max() > 0.01
    env.close()


def test_a_motion_of_ones_own_and_options_for_one_episode() -> None:
    to = point_to_point(np.zeros(7), np.full(7, 0.3), 0.3)
    env = gym.make(NAME, motion=to, episode_length=0.4)
    where = env.unwrapped.layout.slices["reference"]
    np.testing.assert_allclose(env.reset(seed=0)[0][where], 0.0)
    start, _ = env.reset(
        options={
            "motion": point_to_point(np.full(7, 0.1), np.zeros(7), 0.3),
            "effects": (COULOMB,),
        }
    )
    np.testing.assert_allclose(start[where], 0.1, atol=1e-7)
    assert env.unwrapped.effects == (COULOMB,)
    env.reset()
    assert env.unwrapped.effects == ()
    with pytest.raises(InputError, match="did you mean 'motion'"):
        env.reset(options={"motions": to})
    env.close()


@pytest.mark.parametrize("noise", [1e-3, [0.0, 1e-3, 0.0, 2e-3, 0.0, 0.0, 0.0]])
def test_noise_of_the_encoders_has_its_size_and_comes_from_the_seed(
    noise: float | list[float],
) -> None:
    def readings(seed: int | None, env: ArmTracking) -> np.ndarray:
        start, info = env.reset(seed=seed)
        rows, truth = [start[:7]], [info["q_true"]]
        for _ in range(100):
            observation, _, _, _, info = env.step(np.zeros(7))
            rows.append(observation[:7])
            truth.append(info["q_true"])
        return np.array(rows) - np.array(truth)

    env = ArmTracking(
        encoder_noise=noise,
        motion="fourier",
        episode_length=2.0,
        debug=True,
        effects=(COULOMB,),
    )
    first, other, again = readings(3, env), readings(None, env), readings(3, env)
    env.close()
    expected = np.broadcast_to(noise, 7)
    np.testing.assert_allclose(first.std(axis=0), expected, rtol=0.25, atol=1e-6)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    plain = ArmTracking(
        motion="fourier", episode_length=2.0, debug=True, effects=(COULOMB,)
    )
    assert np.abs(readings(3, plain)).max() < 1e-6
    plain.close()


def test_a_joint_at_its_stop_ends_the_episode() -> None:
    """What is told is the encoder's reading, which is off by 0.3 rad, and not the truth."""
    off = AppliedEffect("encoder_offset", tuple(range(1, 8)), {"offset": 0.3})
    env = ArmTracking(action="torque", motion="fourier", effects=(off,), debug=True)
    env.reset(seed=0)
    over = False
    while not over:
        observation, _, over, _, info = env.step(np.zeros(7))
    env.close()
    joint = int(re.search(r"joint (\d)", info["limit"])[1]) - 1
    read = float(re.search(r"its encoder reads (\S+) rad", info["limit"])[1])
    assert "came to its stop" in info["limit"] and read == pytest.approx(
        observation[joint], abs=1e-3
    )
    assert read == pytest.approx(info["q_true"][joint] + 0.3, abs=1e-3)


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
