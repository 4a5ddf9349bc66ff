"""The reward: good tracking, with little and smooth torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.envs.arguments import check_values


class RewardParts(NamedTuple):
    """The parts of one step's reward [1], or of those of N environments, each (N,); their sum is the reward."""

    tracking: np.ndarray
    effort: np.ndarray | float
    smoothness: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """The reward."""
        return self.tracking + self.effort + self.smoothness


@dataclass(frozen=True)
class Reward:
    """Reward of one action, n joints, means over the joints.

    1 / (1 + mean (e / e0)^2) - w_e mean (tau / tau_rated)^2 - w_s mean (a - a_before)^2

    The first part is 1 for perfect tracking, 1/2 at an error of e0, and never negative, so that an episode that ends
    early earns less. The square of tau is averaged over the steps of an action.

    Attributes:
        tolerance: e0, the error of the encoders' position against the reference that halves the tracking part [rad].
        effort: w_e, cost of the rated torque on all joints [1].
        smoothness: w_s, cost of a jump of all actions by one [1].

    Raises:
        InputError: a tolerance that is not above zero, or a negative weight.
    """

    tolerance: float = 0.01
    effort: float = 0.1
    smoothness: float = 0.05

    def __post_init__(self) -> None:
        """Check the numbers; a weight of zero is allowed."""
        check_values(vars(self), "environment", "reward", "reward.")

    def __call__(
        self, error: np.ndarray, load: np.ndarray | float, jump: np.ndarray
    ) -> RewardParts:
        """Parts of the reward of an action, or of those of N environments, each (N,).

        Args:
            error: tracking error e [rad], shape (n,) or (N, n).
            load: mean of (tau / tau_rated)^2 over joints and steps [1], a number or shape (N,).
            jump: change of the action [1], shape (n,) or (N, ...).
        """
        # mean of squares over n joints against the square of the tolerance
        scale = error.shape[-1] * self.tolerance**2
        tracking = 1.0 / (1.0 + np.vecdot(error, error) / scale)
        squares = np.vecdot(jump, jump)
        smoothness = -self.smoothness * squares / jump.shape[-1]
        return RewardParts(tracking, -self.effort * load, smoothness)
