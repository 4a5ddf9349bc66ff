"""Episodes of the environment for tests."""

import gymnasium as gym
import numpy as np

import gapscope  # noqa: F401 (registers the environment)
from gapscope.envs.simulated_arm import SimulatedArm

NAME = "gapscope/ArmTracking-v0"
SHORT = {"episode_length": 0.4, "motion": "fourier"}


def rollout(
    held: np.ndarray | None = None, seed: int = 0, **options: object
) -> tuple[np.ndarray, np.ndarray, dict]:
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


def missing_torque(simulated: SimulatedArm, *state: np.ndarray) -> np.ndarray:
    """What inverse dynamics needs for one step from a state (q, dq) beyond the torque that moved it [N m]."""
    q, dq, torque = state
    simulated.reset(q, dq)
    simulated.step(torque)
    motion = q, dq, (simulated.dq - dq) / simulated.dt
    return simulated.body.inverse_dynamics(*(x[None] for x in motion))[0] - torque
