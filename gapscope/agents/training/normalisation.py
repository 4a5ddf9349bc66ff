"""What an agent sees: the observation, centred and scaled by fixed figures that are saved beside the policy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.npz_file import read_arrays
from gapscope.envs.environment import ArmTracking

LARGEST = 10.0
"""What an agent sees is clipped here [1]."""
EPISODES = 6
"""Untrained episodes that the figures are taken from."""
CENTRED = ("error", "velocity", "action")
"""Quantities about zero, whose mean is left alone."""
FLOORS = {
    "position": 0.05,
    "velocity": 0.02,
    "reference": 0.05,
    "reference_rate": 0.05,
    "look_ahead": 0.005,
}
"""Least scale, in the quantity's unit; a quantity that hardly changes in training may do so elsewhere."""
OTHER_FLOOR = 0.02
"""Least scale of the other quantities."""


@dataclass(frozen=True, eq=False)
class Normalisation:
    """z = clip((x - mean) / scale), where in x the velocity is replaced by that of the error, dq_ref - dq.

    Attributes:
        mean, scale: in the observation's units, shape (m,).
        velocity, reference_rate: first and last place of these quantities in the observation.
    """

    mean: np.ndarray
    scale: np.ndarray
    velocity: tuple[int, int]
    reference_rate: tuple[int, int]

    @classmethod
    def measured(
        cls, env: ArmTracking, seed: int, tolerance: float, episodes: int = EPISODES
    ) -> Normalisation:
        """Figures of episodes in which the agent does nothing.

        Args:
            env: the simulator.
            seed: of the episodes.
            tolerance: of the reward [rad]; errors are scaled by twice this at least.
            episodes: how many.
        """
        slices, size = env.layout.slices, env.layout.size
        velocity, rate = slices["velocity"], slices["reference_rate"]
        places = (velocity.start, velocity.stop), (rate.start, rate.stop)
        unscaled = cls(np.zeros(size), np.ones(size), *places)
        rows = []
        idle = np.zeros(env.actions)
        for number in range(episodes):
            observation, _ = env.reset(seed=seed + number)
            over = False
            while not over:
                rows.append(unscaled._features(observation))
                observation, _, terminated, truncated, _ = env.step(idle)
                over = terminated or truncated
        features = np.array(rows)
        mean = features.mean(axis=0)
        floors = {**FLOORS, "error": 2 * tolerance, "action": 1.0}
        floor = np.empty(size)
        for name, part in slices.items():
            floor[part] = floors.get(name, OTHER_FLOOR)
            if name in CENTRED:
                mean[part] = 0.0
        spread = np.sqrt(np.mean((features - mean) ** 2, axis=0))
        return cls(mean, np.maximum(spread, floor), *places)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """What the agent sees of observations, each of shape (..., m), float32."""
        seen = (self._features(observation) - self.mean) / self.scale
        return np.minimum(np.maximum(seen, -LARGEST), LARGEST).astype(np.float32)

    def _features(self, observation: np.ndarray) -> np.ndarray:
        out = observation.astype(float)
        (a, b), (c, d) = self.velocity, self.reference_rate
        out[..., a:b] = out[..., c:d] - out[..., a:b]
        return out

    def write(self, path: Path) -> None:
        """Write as NPZ; ``path`` never holds half of it."""
        places = np.array([self.velocity, self.reference_rate])
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.savez(
                file,
                allow_pickle=False,
                mean=self.mean,
                scale=self.scale,
                places=places,
            )

    @classmethod
    def read(cls, path: Path) -> Normalisation:
        """Read the NPZ file.

        Raises:
            InputError: it is missing or not such a file.
        """
        content = read_arrays(path, "train the agent again")
        try:
            velocity, rate = (tuple(int(x) for x in row) for row in content["places"])
            return cls(content["mean"], content["scale"], velocity, rate)  # type: ignore[arg-type]
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise InputError(
                f"is no normalisation ({error})", "train the agent again", file=path
            ) from None


class Normalised(gymnasium.ObservationWrapper):
    """An environment as an agent sees it."""

    def __init__(self, env: gymnasium.Env, normalisation: Normalisation) -> None:
        super().__init__(env)
        self._normalisation = normalisation
        self.observation_space = Box(
            -LARGEST, LARGEST, env.observation_space.shape, np.float32
        )

    def observation(self, observation: Any) -> np.ndarray:
        """What the agent sees."""
        return self._normalisation(observation)
