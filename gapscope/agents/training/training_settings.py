"""How an agent is trained: the settings file, and the hyperparameters that it may name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.json_file import plain, schema
from gapscope.arm.motions.named_motions import MOTIONS
from gapscope.arm.nearest_name import check_keys, check_known, nearest
from gapscope.envs.actions import ACTION_KINDS
from gapscope.envs.arguments import check_values
from gapscope.envs.engines import check_engine
from gapscope.envs.mystery_arm import HIDDEN
from gapscope.envs.randomisation import Randomisation
from gapscope.envs.reward import Reward

ALGORITHMS = ("ppo", "sac", "td3")
"""Sections of ``gapscope/schemas/training.schema.json``, which has their hyperparameters."""
RESIDUAL = "ppo_residual"
"""Settings that ship for models without inverse dynamics."""


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training.

    A training is made of rounds; after each the agent is evaluated and a checkpoint written.

    Attributes:
        algorithm: one of ``ALGORITHMS``.
        steps: actions to train for, all environments together, rounded down to what the algorithm collects at once.
        round_steps: actions in a round, rounded up to what the algorithm collects at once.
        environments: that are stepped side by side.
        parallel: whether each runs in a separate process.
        network: units of the hidden layers of the policy.
        value_network: of the value function; those of the policy if ``None``.
        hyperparameters: of the algorithm, by the names of stable-baselines3.
        exploration: standard deviation of the untrained agent's actions [1].
        final_rate: learning rate in the last round, over that in the first; it falls from round to round [1].
        action: one of ``gapscope.envs.actions.ACTION_KINDS``.
        action_reach: with ``residual``, tracking error at which kp alone commands as much as an action of 1 [rad].
        bandwidth: of the PD loop [Hz].
        episode_length: of training [s].
        motion: of training; a name, or ``random``.
        tolerance, effort, smoothness: of the reward, see ``gapscope.envs.reward.Reward`` [rad], [1], [1].
        motions, seeds, duration: of the evaluation: names, how many seeds of each, length [s].
        patience: evaluations without improvement after which training ends.
        improvement: least gain of the mean reward per action that counts as improvement [1].
        randomise: effects that are drawn around the model at every reset; ``None`` leaves them to ``Task.settled``.
        count, severity: how many, and how severe, see ``gapscope.envs.randomisation.Randomisation``.
        engine: that simulates training; on ``mujoco`` all environments are stepped together.
        seed: of weights, motions and exploration.

    Raises:
        InputError: a value that cannot be used.
    """

    algorithm: str = "ppo"
    steps: int = 100_000
    round_steps: int = 10_000
    environments: int = 4
    parallel: bool = False
    network: tuple[int, ...] = (64, 64)
    value_network: tuple[int, ...] | None = None
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    exploration: float = 0.1
    final_rate: float = 0.1
    action: str = "residual"
    action_reach: float = 0.03
    bandwidth: float = 4.0
    episode_length: float = 4.0
    motion: str = "random"
    tolerance: float = 0.002
    effort: float = 0.0
    smoothness: float = 0.05
    motions: tuple[str, ...] = ("fourier", "pick", "place", "weld_seam")
    seeds: int = 1
    duration: float = 4.0
    patience: int = 1000
    improvement: float = 0.0
    randomise: tuple[str, ...] | None = None
    count: tuple[int, int] = (0, 3)
    severity: tuple[float, float] = (0.5, 1.0)
    engine: str = "mujoco"
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every value."""
        check_known("algorithm", self.algorithm, ALGORITHMS, where="algorithm")
        check_known("action", self.action, ACTION_KINDS, where="action")
        check_engine(self.engine)
        check_values(vars(self), "training", "settings")
        for name in ("network", "value_network", "motions", "randomise"):
            value = getattr(self, name)
            object.__setattr__(self, name, value if value is None else tuple(value))
        for name in ("count", "severity"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        motions = (*MOTIONS, "random")
        check_known("motion", self.motion, motions, where="motion")
        for name in self.motions:
            check_known("motion", name, motions, where="motions")
        known = schema("training")["properties"][self.algorithm]["properties"]
        for name in self.hyperparameters:
            place = f"hyperparameters.{name}"
            check_known(f"hyperparameter of {self.algorithm}", name, known, place)
        given = self.hyperparameters
        check_values(given, "training", self.algorithm, "hyperparameters.")
        object.__setattr__(self, "hyperparameters", dict(self.hyperparameters))
        _ = self.reward, self.randomisation  # they check their own numbers

    @property
    def reward(self) -> Reward:
        """The reward."""
        return Reward(self.tolerance, self.effort, self.smoothness)

    @property
    def reach(self) -> float | None:
        """The reach of an action, of actions of the kind that has one."""
        return self.action_reach if self.action == "residual" else None

    @property
    def randomisation(self) -> Randomisation | None:
        """What is drawn at every reset, or ``None``."""
        if not self.randomise:
            return None
        return Randomisation(self.randomise, count=self.count, severity=self.severity)

    @property
    def _unit(self) -> int:
        """Actions that the algorithm collects at once."""
        names = {"ppo": ("n_steps", 2048)}
        name, default = names.get(self.algorithm, ("train_freq", 1))
        return int(self.hyperparameters.get(name, default)) * self.environments

    @property
    def total(self) -> int:
        """Actions of a whole training: ``steps``, rounded down to what is collected at once, which is the least."""
        return max(self.steps // self._unit, 1) * self._unit

    @property
    def round_length(self) -> int:
        """Actions in a round but the last: a multiple of what is collected at once."""
        return self._unit * -(-self.round_steps // self._unit)

    @property
    def rounds(self) -> int:
        """Rounds of a whole training."""
        return -(-self.total // self.round_length)

    def randomised(self) -> TrainingSettings:
        """The same with domain randomisation: over the effects that a diagnosis can find if none are named."""
        return self if self.randomise else replace(self, randomise=HIDDEN)

    def same(self) -> dict[str, Any]:
        """What makes two trainings the same, as JSON data: all but ``parallel``."""
        return {**self.plain(), "parallel": False}

    def plain(self) -> dict[str, Any]:
        """As YAML or JSON data."""
        return dict(plain(self))


def read_settings(agent: str | Path, **changed: Any) -> TrainingSettings:
    """Settings from a file, or those that ship under the name of an algorithm.

    Args:
        agent: one of ``ALGORITHMS``, ``RESIDUAL``, or the path of a YAML file with the fields of ``TrainingSettings``.
        changed: fields to put instead of the file's; those that are ``None`` are not.

    Raises:
        InputError: no such file or algorithm, an unknown key, or a value of the wrong kind; names file and field.
    """
    changed = {name: value for name, value in changed.items() if value is not None}
    path = Path(agent)
    if agent in (*ALGORITHMS, RESIDUAL):
        path = Path(
            str(files("gapscope.agents.training") / "configs" / f"{agent}.yaml")
        )
    elif path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"unknown agent {str(agent)!r}",
            f"{nearest(str(agent), ALGORITHMS)}give {', '.join(ALGORITHMS)}, or a YAML file with settings",
            where="--agent",
        )
    content = read_yaml(path, "check the path")
    try:
        return from_plain(content, **changed)
    except InputError as error:
        raise error.at(path) from None


def from_plain(content: Any, **changed: Any) -> TrainingSettings:
    """Settings from names with values.

    Raises:
        InputError: an unknown name, or a value that cannot be used.
    """
    known = [f.name for f in fields(TrainingSettings)]
    content = check_keys(content, known)
    return TrainingSettings(**{**content, **changed})
