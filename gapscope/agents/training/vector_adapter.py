"""The vector environment as stable-baselines3 wants it, with observations as an agent sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv

from gapscope.agents.training.task import LARGEST, Normalisation
from gapscope.envs.environment import VectorArmTracking


class NormalisedArms(VecEnv):
    """The environments of a ``VectorArmTracking`` whose episodes follow each other in the same step.

    Same seeds and actions give what ``DummyVecEnv`` of single environments gives, bit by bit.

    Args:
        env: the environments, with ``autoreset_mode="SameStep"``.
        normalisation: of the observations.
    """

    def __init__(self, env: VectorArmTracking, normalisation: Normalisation) -> None:
        self._env, self._normalisation = env, normalisation
        shape = env.single_observation_space.shape
        seen = Box(-LARGEST, LARGEST, shape, np.float32)
        super().__init__(env.num_envs, seen, env.single_action_space)

    def reset(self) -> np.ndarray:
        """Begin an episode in every environment; the observations."""
        observations, self.reset_infos = (
            self._env.reset(seed=self._seeds)[0],
            [{} for _ in range(self.num_envs)],
        )
        self._reset_seeds()
        self._reset_options()
        return self._normalisation(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for ``step_wait``."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Carry out the actions; observations, rewards, whether episodes ended, and infos of those that did."""
        found = self._env.step(self._actions)
        observations, rewards, terminated, truncated, infos = found
        ended = terminated | truncated
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for number in np.flatnonzero(ended).tolist():
            last = self._normalisation(infos["final_obs"][number])
            told[number] = {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(truncated[number] > terminated[number]),
            }
        seen = self._normalisation(observations)
        return seen, rewards.astype(np.float32), ended, told

    def close(self) -> None:
        """Close the environments."""
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, once for each."""
        return [getattr(self._env, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the environments share what they are made of."""
        raise NotImplementedError(
            "the environments of one arm have no attributes of their own"
        )

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **options: Any
    ) -> list[Any]:
        """Refused, for the same reason."""
        raise NotImplementedError(
            "the environments of one arm have no methods of their own"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No environment is wrapped."""
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))
