"""The environment: Gymnasium's contract, tracking, effects, rewards, endings and bad arguments."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

gym = pytest.importorskip("gymnasium", reason="the environment needs gymnasium, a dependency of the package")

import gapscope  # noqa: E402, F401 (registers the environment)
from arm.dynamics import RigidBody  # noqa: E402
from arm.errors import InputError, ModelWarning  # noqa: E402
from arm.feedforward import feedforward  # noqa: E402
from arm.motions import MOTIONS, draw_motion  # noqa: E402
from arm.point_to_point import PointToPoint  # noqa: E402
from arm.robots import KNOWN_ROBOTS  # noqa: E402
from arm.trajectory import Limits  # noqa: E402
from arm.velocity_filter import VelocityFilter  # noqa: E402
from effects.applied import AppliedEffect  # noqa: E402
from effects.corrected_file import write_corrected  # noqa: E402
from envs.actions import KINDS, Control, Gains, torque_limit  # noqa: E402
from envs.divergence import diverged, explain, longest_step  # noqa: E402
from envs.engines import installed  # noqa: E402
from envs.environment import ArmTracking  # noqa: E402
from envs.reward import Reward  # noqa: E402
from envs.velocity_estimate import VELOCITY_DAMPING, cutoff  # noqa: E402

NAME = "gapscope/ArmTracking-v0"
ROOT = Path(__file__).parents[2]
SHORT = {"episode_length": 0.4, "motion": "fourier"}
COULOMB = AppliedEffect("coulomb_friction", (1, 4), {"torque": [3.0, 2.0]})


def rollout(held: np.ndarray | None = None, seed: int = 0, **options: object) -> tuple[np.ndarray, np.ndarray, dict]:
    """Observations, rewards, and the last info of one episode with a constant action, zero by default."""
    env = gym.make(NAME, **options)
    held = np.zeros(env.action_space.shape, np.float32) if held is None else held
    observations, rewards, over = [env.reset(seed=seed)[0]], [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(held)
        observations.append(observation)
        rewards.append(reward)
        over = terminated or truncated
    env.close()
    return np.array(observations), np.array(rewards), info | {"terminated": terminated}


def errors(observations: np.ndarray, n: int = 7) -> np.ndarray:
    return observations[:, 2 * n : 3 * n]


@pytest.mark.parametrize("options", [{}, {"action": "torque"}, {"effects": (COULOMB,), "debug": True}])
def test_gymnasium_checker_passes(options: dict, recwarn: pytest.WarningsRecorder) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(gym.make(NAME, **SHORT, **options).unwrapped)
    assert [str(w.message) for w in recwarn if "gymnasium" in str(w.filename)] == []


@pytest.mark.parametrize("action", KINDS)
def test_stable_baselines_checker(action: str, recwarn: pytest.WarningsRecorder) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra learn")
    recwarn.clear()
    env = gym.make(NAME, action=action, **SHORT)
    checker.check_env(env)
    env.close()
    assert [str(w.message) for w in recwarn] == []


def test_stable_baselines_vector_environment() -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra learn")
    from stable_baselines3.common.vec_env import DummyVecEnv

    vector = DummyVecEnv([lambda: gym.make(NAME, **SHORT)] * 2)
    vector.reset()
    for _ in range(25):
        observation, _, done, info = vector.step(np.zeros((2, 7), np.float32))
        if done.any():
            assert "terminal_observation" in info[0]
    assert observation.shape == (2, 70)
    vector.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_eight_environments_in_vector_form(mode: str) -> None:
    vector = gym.make_vec(NAME, num_envs=8, vectorization_mode=mode, **SHORT)
    observation, _ = vector.reset(seed=0)
    for _ in range(25):
        after, reward, _, _, info = vector.step(np.zeros((8, 7), np.float32))
    assert after.shape == (8, 70) and reward.shape == (8,) and info["reward_tracking"].shape == (8,)
    assert len({row.tobytes() for row in observation}) == 8
    vector.close()


@pytest.mark.parametrize(
    "code", ["import gapscope, gymnasium as gym; name = ''", "import gymnasium as gym; name = 'gapscope:'"]
)
def test_made_by_name_with_and_without_an_import(code: str) -> None:
    code += f"\nenv = gym.make(name + {NAME!r}, episode_length=0.1); env.reset(); print(env.spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith(NAME)


def test_import_is_light_and_works_without_gymnasium() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import importlib.util as u; found = u.find_spec\n"
    code += "u.find_spec = lambda name, *rest: None if name == 'gymnasium' else found(name, *rest)\n"
    code += "import gapscope; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert not {"pybullet", "pinocchio", "PIL", "scipy", "torch"} & set(done.stdout.split())


@pytest.mark.parametrize("action", ["residual", "torque"])
def test_same_seed_same_episode_bit_by_bit(action: str) -> None:
    options = {"action": action, "effects": (COULOMB,), "episode_length": 0.6}
    first, second, other = (rollout(seed=seed, **options) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
def test_pd_with_nominal_feedforward_tracks(robot: str, motion: str) -> None:
    """Without effects and with zero action the arm keeps within 3 mrad of every motion."""
    observations, rewards, info = rollout(robot=robot, motion=motion, episode_length=2.0, engine="pybullet")
    assert np.abs(errors(observations, 6 if robot == "xarm6" else 7)).max() < 3e-3
    assert rewards.min() > 0.9 and not info["terminated"]


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_engines_agree(engine: str) -> None:
    if not installed(engine):
        pytest.skip(f"the engine {engine} is not installed")
    options = {"motion": "fourier", "episode_length": 2.0, "effects": (COULOMB,)}
    first, second = (rollout(engine=name, **options)[0][:, :7] for name in ("pybullet", engine))
    assert np.sqrt(np.mean((first - second) ** 2)) < 1e-3


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
    for values, expected in ((env.arm.armature, 0.1), (env.arm.coulomb, 0.2), (env.arm.viscous, 0.3)):
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
        rollout(effects=effects, **options) for effects in (None, (effect,), tmp_path / "corrected.yaml")
    )
    assert np.abs(errors(given[0])).max() > 1.5 * np.abs(errors(clean[0])).max()
    np.testing.assert_array_equal(given[0], read[0])


def test_dry_friction_sticks_without_chatter() -> None:
    """Pushed off its posture and let go, the arm comes to rest away from it, and for good."""
    posture = np.array([0.0, 0.73, 0.0, -1.62, 0.0, 0.57, 0.0])
    friction = AppliedEffect("coulomb_friction", tuple(range(1, 8)), {"torque": 2.0})
    stand = PointToPoint(posture, posture, 1.0)
    options = {"feedforward": "gravity", "action_share": 1.0, "episode_length": 4.0, "debug": True}
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
        parts = [info[f"reward_{part}"] for part in ("tracking", "effort", "smoothness")]
        assert reward == pytest.approx(sum(parts)) and info["tracking_rms"] > 0
        assert (
            type(reward) is float and parts[1] == pytest.approx(-0.1 * 0.01) and parts[2] == pytest.approx(-0.05 * 0.01)
        )
        assert ("torque_applied" in info) == ("q_true" in info) == ("effects" in start) == debug
        env.close()
    expected = 0.1 * env.unwrapped.torque_scale
    np.testing.assert_allclose(info["torque_commanded"], expected, rtol=1e-6)
    np.testing.assert_allclose(info["torque_applied"], expected, rtol=1e-6)


def test_observation_holds_what_its_layout_says() -> None:
    env = gym.make(NAME, motion="fourier", effects=None, look_ahead=(0.02, 0.1), action_share=0.05).unwrapped
    observation, _ = env.reset(seed=1)
    rows = [observation]
    for _ in range(100):
        rows.append(env.step(np.full(7, 0.5, np.float32))[0])
    part = {name: np.array(rows, dtype=float)[:, where] for name, where in env.layout.slices.items()}
    np.testing.assert_allclose(part["error"], part["reference"] - part["position"], atol=1e-6)
    np.testing.assert_allclose(part["look_ahead"][:-1, :7], np.diff(part["reference"], axis=0), atol=1e-6)
    np.testing.assert_allclose(part["look_ahead"][:-5, 7:], part["reference"][5:] - part["reference"][:-5], atol=1e-6)
    np.testing.assert_array_equal(part["action"], [[0.0] * 7] + [[0.5] * 7] * 100)
    slope = (part["position"][2:] - part["position"][:-2]) / 0.04
    late = 0.5 * (part["velocity"][1:-1] + part["velocity"][2:])[20:]  # the estimate lags by about 4 ms
    np.testing.assert_allclose(late, slope[20:], atol=0.08)
    assert np.abs(part["feedforward"]).max() > 0.01
    env.close()


def test_a_motion_of_ones_own_and_options_for_one_episode() -> None:
    to = PointToPoint(np.zeros(7), np.full(7, 0.3), 0.3)
    env = gym.make(NAME, motion=to, episode_length=0.4)
    where = env.unwrapped.layout.slices["reference"]
    np.testing.assert_allclose(env.reset(seed=0)[0][where], 0.0)
    start, _ = env.reset(options={"motion": PointToPoint(np.full(7, 0.1), np.zeros(7), 0.3), "effects": (COULOMB,)})
    np.testing.assert_allclose(start[where], 0.1, atol=1e-7)
    assert env.unwrapped.effects == (COULOMB,)
    env.reset()
    assert env.unwrapped.effects == ()
    with pytest.raises(InputError, match="did you mean 'motion'"):
        env.reset(options={"motions": to})
    env.close()


def message(info: dict) -> str:
    return info["divergence"]["message"]


def test_divergence_is_noticed_at_once_and_explained(pendulum_urdf: Path) -> None:
    """Too large a step or gains; no torque limit and no damping; each with the arguments to change."""
    for bandwidth, step in ((200.0, 1e-3), (4.0, 20e-3)):
        _, _, info = rollout(bandwidth=bandwidth, time_step=step, sub_steps=round(0.02 / step), **SHORT)
        assert info["terminated"] and "PD loop is unstable" in message(info) and "bandwidth" in message(info)
        assert "action_share or action_reach" in message(info)
    assert "time_step below" in message(info)
    push = np.ones(1, np.float32)
    _, rewards, info = rollout(push, robot=pendulum_urdf, action="torque", motion="fourier", action_share=100.0)
    assert info["terminated"] and info["divergence"]["joint"] == 1
    assert "torque_limit" in message(info) and "viscous" in message(info) and np.isfinite(rewards).all()
    assert "a smaller action_share" in message(info)
    assert info["divergence"]["speed"] > 50.0 and info["divergence"]["time"] < 0.05


def test_a_speed_that_is_no_number_is_a_divergence_too(pendulum) -> None:
    """And a speed below the bound on every joint is none, whatever they come to together."""
    assert diverged(np.array([0.0, np.nan])) and diverged(np.array([0.0, -50.1])) and diverged(np.array([np.inf]))
    assert not diverged(np.full(7, 49.0))
    control = Control("torque", np.ones(1), np.ones(1), np.full(1, np.inf), None)
    told = explain(pendulum(), RigidBody(pendulum()), control, 1e-3, 0.1, np.zeros(1), np.array([np.nan]))
    assert "joint 1 ran away: a speed that is no number" in told.as_info()["message"]


@pytest.mark.parametrize("change", ["time_step", "bandwidth"])
def test_what_the_explanation_of_a_divergence_says_to_change_helps(change: str) -> None:
    options: dict = {"bandwidth": 4.0, "time_step": 20e-3, "sub_steps": 1}
    _, _, info = rollout(**options, **SHORT)
    value = float(re.search(rf"{change} below ([\d.e-]+)", message(info))[1])
    options |= {change: 0.9 * value if change == "time_step" else 0.9 * value * options["bandwidth"]}
    assert not rollout(**options, **SHORT)[2]["terminated"]


@pytest.mark.parametrize("action", ["residual", "torque"])
def test_an_action_that_diverges_earns_nothing_and_keeps_its_books(pendulum_urdf: Path, action: str) -> None:
    """A posture kept by the encoders is no merit then; torque and its change are those of the steps done."""
    share = 1e4 if action == "residual" else 100.0
    options = {"robot": pendulum_urdf, "action": action, "action_share": share, "debug": True, **SHORT}
    env = gym.make(NAME, **options).unwrapped
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.ones(1))
    assert terminated and info["divergence"]["speed"] > 50.0
    numbers = (reward, *(info[name] for name in ("tracking_rms", "torque_rate", "reward_effort")))
    assert np.isfinite(numbers).all() and type(reward) is float and reward < 0
    assert info["reward_tracking"] == 0 and info["torque_rate"] > 0
    assert info["reward_effort"] == pytest.approx(-0.1 * share**2, rel=0.01)
    env.close()


@pytest.mark.parametrize(("kp", "kd", "viscous"), [(400.0, 8.0, 0.0), (400.0, 8.0, 5.0), (2000.0, 30.0, 0.0)])
def test_longest_stable_step_against_the_loop_itself(pendulum, kp: float, kd: float, viscous: float) -> None:
    """A pushed joint under PD with the velocity estimate comes to rest a little below it, and not a little above."""
    arm, gains, mass = pendulum(viscous=viscous), Gains(np.array([kp]), np.array([kd])), 0.55
    longest = longest_step(np.array([[mass]]), arm, gains, 0.2)
    assert longest is not None

    def last(dt: float) -> float:
        estimate = VelocityFilter(1 / dt, cutoff(1 / dt), VELOCITY_DAMPING, np.zeros(1), np.zeros(1))
        q, dq = np.zeros(1), np.full(1, 1e-3)
        for _ in range(3000):
            torque = -kp * q - kd * estimate(q)
            dq = (mass * dq + dt * torque) / (mass + dt * viscous)
            q = q + dt * dq
        return float(np.abs(dq[0]))

    assert last(0.97 * longest) < 1e-5 and last(1.03 * longest) > 1.0
    assert longest_step(np.array([[mass]]), arm, gains, 0.97 * longest) is None


def test_gains_that_no_step_holds(pendulum) -> None:
    assert longest_step(np.array([[0.55]]), pendulum(), Gains(np.array([1e6]), np.array([1e4])), 1e-3) == 0.0


@pytest.mark.parametrize("action", ["residual", "torque"])
@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
@pytest.mark.filterwarnings("ignore::arm.errors.ModelWarning")
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
@pytest.mark.filterwarnings("ignore::arm.errors.ModelWarning")
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
                env.arm, env.body, "nominal", drawn.position(t), drawn.velocity(t), drawn.acceleration(t)
            )
            assert (np.abs(needed).max(axis=0) < 0.95 * env.torque_scale).all()


@pytest.mark.parametrize("noise", [1e-3, [0.0, 1e-3, 0.0, 2e-3, 0.0, 0.0, 0.0]])
def test_noise_of_the_encoders_has_its_size_and_comes_from_the_seed(noise: float | list[float]) -> None:
    def readings(seed: int | None, env: ArmTracking) -> np.ndarray:
        start, info = env.reset(seed=seed)
        rows, truth = [start[:7]], [info["q_true"]]
        for _ in range(100):
            observation, _, _, _, info = env.step(np.zeros(7))
            rows.append(observation[:7])
            truth.append(info["q_true"])
        return np.array(rows) - np.array(truth)

    env = ArmTracking(encoder_noise=noise, motion="fourier", episode_length=2.0, debug=True, effects=(COULOMB,))
    first, other, again = readings(3, env), readings(None, env), readings(3, env)
    env.close()
    expected = np.broadcast_to(noise, 7)
    np.testing.assert_allclose(first.std(axis=0), expected, rtol=0.25, atol=1e-6)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    plain = ArmTracking(motion="fourier", episode_length=2.0, debug=True, effects=(COULOMB,))
    assert np.abs(readings(3, plain)).max() < 1e-6
    plain.close()


@pytest.mark.parametrize(
    ("action", "kind", "text"),
    [
        (np.full(7, np.nan), "residual", "not finite"),
        (np.array([np.inf] + [0.0] * 6), "torque", "not finite"),
        (np.zeros(1), "residual", r"expected 7 numbers in -1 .. 1, got shape \(1,\)"),
        (np.zeros((1, 7)), "residual", r"shape \(1, 7\)"),
        (0.0, "torque", r"shape \(\)"),
        (np.zeros(7), "scale", "expected 14 numbers"),
        (["much"] * 7, "residual", "not a number"),
    ],
)
def test_actions_at_fault_are_refused(action: object, kind: str, text: str) -> None:
    env = ArmTracking(action=kind)
    env.reset(seed=0)
    with pytest.raises(InputError, match=text) as caught:
        env.step(action)
    assert caught.value.where == "action"
    env.step(np.zeros(env.actions))  # the episode goes on
    env.close()


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
    assert "came to its stop" in info["limit"] and read == pytest.approx(observation[joint], abs=1e-3)
    assert read == pytest.approx(info["q_true"][joint] + 0.3, abs=1e-3)


def test_stepping_on_after_the_end_is_refused() -> None:
    env = ArmTracking(episode_length=0.02)
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded):
            env.step(np.zeros(7))
        env.reset(seed=0)
        assert env.step(np.zeros(7))[3]
    env.close()


STRAY = AppliedEffect("coulomb_friction", (9,), {"torque": [1.0]})
BAD = [
    ({"robot": "kuka_iwa"}, "did you mean 'kuka_iiwa'"),
    ({"engine": "pybulet"}, "pybullet"),
    ({"effects": (STRAY,)}, "joint 9 of an arm with 7 joints(?s:.)*joints count from 1"),
    (
        {"effects": ("coulomb_friction",)},
        r"effects\[0\]: expected AppliedEffect, got 'coulomb_fric(?s:.)*give AppliedEffect",
    ),
    ({"effects": "coulomb_friction"}, "is the name of an effect, without values(?s:.)*give AppliedEffect"),
    ({"effects": 3}, "effects: 3 is no effect with values"),
    ({"effects": {"effects": [], "residual": "residual.npz"}}, "a residual network is no effect(?s:.)*simulated="),
    ({"effects": {"effect": "payload"}}, r"effects\[0\], payload: expected the parameters"),
    (
        {"effects": [{"effect": "payload", "parameters": {"mass": 1}}]},
        r"effects\[0\], payload: expected the parameters",
    ),
    ({"robot": "panda"}, "did you mean 'franka_panda'"),
    ({"robot": "KUKA_IIWA"}, "did you mean 'kuka_iiwa'"),
    ({"robot": None}, "robot: expected NominalArm, got None(?s:.)*xarm6"),
    ({"robot": 3}, "robot: expected NominalArm, got 3"),
    ({"engine": "MuJoCo"}, "did you mean 'mujoco'"),
    ({"simulated": "corrected.yaml"}, "simulated: expected CorrectedArm(?s:.)*read_corrected_arm"),
    ({"encoder_noise": -1e-3}, "encoder_noise: expected one number from zero on, or 7"),
    ({"encoder_noise": [1e-3] * 6}, "encoder_noise"),
    ({"encoder_noise": float("nan")}, "encoder_noise"),
    ({"encoder_noise": "some"}, "encoder_noise: holds what is not a number"),
    ({"reward": {"tolerance": 0.01}}, "reward: expected Reward"),
    ({"reward": 0.01}, "reward: expected Reward"),
    ({"randomisation": "payload"}, "randomisation: expected Randomisation"),
    ({"limits": 3}, "limits: expected Limits, got 3"),
    ({"limits": Limits([-1.0] * 7, [1.0] * 7, [1.0] * 6, [1.0] * 7)}, "limits.velocity: expected 7 numbers"),
    ({"limits": Limits([1.0] * 7, [1.0] * 7, [1.0] * 7, [1.0] * 7)}, "limits: lower has to be below upper"),
    ({"limits": Limits([-1.0] * 7, [1.0] * 7, [1.0] * 7, ["x"] * 7)}, "limits: holds what is not a number"),
    ({"effects": "missing.yaml"}, "missing.yaml"),
    ({"action": "torqe"}, "did you mean 'torque'"),
    ({"feedforward": "full"}, "nominal"),
    ({"motion": "weld"}, "did you mean 'weld_seam'"),
    ({"motion": 3}, "is no motion"),
    ({"motion": PointToPoint(np.zeros(3), np.ones(3), 1.0)}, r"shape \(1, 3\)"),
    ({"posture": [0.0] * 6}, "expected 7 numbers"),
    ({"posture": [9.0] * 7}, "outside its limits"),
    ({"posture": "home"}, "posture: holds what is not a number"),
    ({"posture": [float("nan")] * 7}, "outside its limits"),
    ({"episode_length": -1.0}, "episode_length: expected a number above zero"),
    ({"time_step": 0.0}, "time_step"),
    ({"time_step": float("nan")}, "time_step"),
    ({"sub_steps": 2.5}, "sub_steps: expected a whole number"),
    ({"look_ahead": [-0.1]}, "look_ahead"),
    ({"look_ahead": [float("inf")]}, "look_ahead: expected times above zero"),
    ({"look_ahead": 0.1}, "look_ahead: expected times above zero(?s:.)*give a list"),
    ({"look_ahead": "soon"}, "look_ahead: holds what is not a number"),
    ({"look_ahead": None}, "look_ahead: expected times above zero"),
    ({"bandwidth": 0}, "bandwidth"),
    ({"action_share": -1}, "action_share"),
    ({"render_mode": "ascii"}, "rgb_array"),
    ({"sheet": {"torque_limit": [1.0]}}, "sheet.torque_limit: expected 7 numbers"),
    ({"sheet": {"torque_limit": [0.0] * 7}}, "sheet.torque_limit: 0 N m at joint 1(?s:.)*above zero"),
    ({"sheet": {"torque_limit": [1.0] * 6 + [-1.0]}}, "sheet.torque_limit: -1 N m at joint 7"),
    ({"sheet": {"armature": [0.1] * 6 + [-0.1]}}, r"sheet.armature: -0.1 kg m\^2 at joint 7(?s:.)*from zero on"),
    ({"sheet": {"viscous": [float("nan")] * 7}}, "sheet.viscous: nan N m s/rad at joint 1"),
    ({"sheet": {"viscous": 1.0}}, "sheet.viscous: expected 7 numbers, one per joint, got 1.0(?s:.)*give a list"),
    ({"sheet": {"coulomb": ["much"] * 7}}, "sheet.coulomb: holds what is not a number"),
    ({"sheet": {"encoder_step": -1e-4}}, "sheet.encoder_step: expected a number from zero on"),
    ({"sheet": {"encoder_step": float("nan")}}, "sheet.encoder_step"),
    ({"sheet": {"armatur": [0.1] * 7}}, "sheet: unknown entry of a data sheet 'armatur'(?s:.)*did you mean 'armature'"),
    ({"sheet": "sheet.yaml"}, "sheet: expected entries by name"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=lambda value: str(value)[:40])
def test_bad_arguments_are_refused_with_what_to_do(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ArmTracking(**options)


def test_effects_as_records_and_as_entries() -> None:
    """One or several, as records, as entries of a corrected.yaml, or as its whole content."""
    entry = {"effect": "coulomb_friction", "joints": [1, 4], "parameters": {"torque": [3.0, 2.0]}}
    for effects in (COULOMB, [COULOMB], entry, [entry], {"schema": 1, "effects": [entry]}):
        env = ArmTracking(effects=effects)
        (found,) = env.effects
        assert (found.name, found.joints, found.parameters["torque"].tolist()) == ("coulomb_friction", (1, 4), [3, 2])
        env.reset(seed=0, options={"effects": effects})
        env.close()


def test_a_residual_network_among_effects_is_pointed_to_where_it_goes(tmp_path: Path) -> None:
    (tmp_path / "corrected.yaml").write_text("schema: 1\neffects: []\nresidual: residual.npz\n")
    with pytest.warns(ModelWarning, match="simulated=effects.corrected_file.read_corrected_arm"):
        ArmTracking(effects=tmp_path / "corrected.yaml").close()


def test_effects_at_fault_leave_the_environment_as_it_was() -> None:
    """The next episode is simulated as if nothing had happened."""
    env = ArmTracking(episode_length=0.2)
    bare = AppliedEffect("joint_elasticity", (2,), {"stiffness": 1e4, "damping": 0.0})
    for options in ({"effects": (bare,)}, {"effects": 3}, {"randomisation": "payload"}, {"motion": None}):
        with pytest.raises(InputError):
            env.reset(seed=0, options=options)
    env.reset(seed=0)
    env.step(np.zeros(7))
    env.close()


def test_bad_rewards_are_refused() -> None:
    for options in ({"tolerance": 0.0}, {"effort": -1.0}):
        with pytest.raises(InputError, match="above zero"):
            Reward(**options)
    Reward(effort=0, smoothness=0.0)


def test_the_example_of_the_documentation_runs(capsys: pytest.CaptureFixture) -> None:
    text = (ROOT / "docs/environment.md").read_text(encoding="utf-8")
    example = text.split("```python\n")[1].split("```")[0]
    assert len(example.strip().splitlines()) <= 20
    exec(compile(example, "docs/environment.md", "exec"), {})
    assert "mrad" in capsys.readouterr().out
