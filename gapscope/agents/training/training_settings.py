"""How an agent is trained: the settings file, and the hyperparameters that it may name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.motions.named_motions import MOTIONS
from gapscope.arm.nearest_name import check_known, nearest
from gapscope.envs.actions import ACTION_KINDS
from gapscope.envs.arguments import positive, whole
from gapscope.envs.engines import check_engine
from gapscope.envs.mystery_arm import HIDDEN
from gapscope.envs.randomisation import Randomisation
from gapscope.envs.reward import Reward

A_WHOLE_NUMBER, NUMBER, ENTROPY = (
    "a whole number from 1 on",
    "a number from 0 on",
    "a number, auto, or auto_ and a number",
)
COUNT = "a whole number from 0 on"
_COMMON = {"learning_rate": NUMBER, "gamma": NUMBER, "batch_size": A_WHOLE_NUMBER}
_REPLAY = {
    "buffer_size": A_WHOLE_NUMBER,
    "learning_starts": COUNT,
    "tau": NUMBER,
    "train_freq": A_WHOLE_NUMBER,
    "gradient_steps": A_WHOLE_NUMBER,
}
KNOWN: dict[str, dict[str, str]] = {
    "ppo": {
        **_COMMON,
        "n_steps": A_WHOLE_NUMBER,
        "n_epochs": A_WHOLE_NUMBER,
        "gae_lambda": NUMBER,
        "clip_range": NUMBER,
        "ent_coef": NUMBER,
        "vf_coef": NUMBER,
        "max_grad_norm": NUMBER,
        "target_kl": NUMBER,
    },
    "sac": {
        **_COMMON,
        **_REPLAY,
        "ent_coef": ENTROPY,
        "target_entropy": "a number or auto",
    },
    "td3": {
        **_COMMON,
        **_REPLAY,
        "policy_delay": A_WHOLE_NUMBER,
        "target_policy_noise": NUMBER,
        "target_noise_clip": NUMBER,
    },
}
"""By algorithm: names as in stable-baselines3, and what is expected."""
ALGORITHMS = tuple(KNOWN)


def checked(algorithm: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """The hyperparameters, if the algorithm has them and their values are of the kind that it expects.

    Raises:
        InputError: an unknown name, or a value of another kind.
    """
    known = KNOWN[algorithm]
    for name, value in given.items():
        where = f"hyperparameters.{name}"
        if name not in known:
            raise InputError(
                f"{algorithm} has no hyperparameter {name!r}",
                f"{nearest(str(name), known)}known are {', '.join(known)}",
                where=where,
            )
        if known[name] == A_WHOLE_NUMBER:
            whole(where, value)
        elif not _fits(known[name], value):
            raise InputError(f"expected {known[name]}, got {value!r}", where=where)
    return dict(given)


def _fits(expected: str, value: Any) -> bool:
    if isinstance(value, str):
        start, _, number = value.partition("_")
        return (
            start == "auto"
            and expected != NUMBER
            and (not number or (expected == ENTROPY and _is_number(number)))
        )
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    if expected == COUNT:
        return isinstance(value, int) and value >= 0
    return expected == "a number or auto" or 0 <= value < float("inf")


def _is_number(text: str) -> bool:
    try:
        return float(text) > 0
    except ValueError:
        return False


POSITIVE = {
    "action_reach": "rad",
    "exploration": "1",
    "final_rate": "1",
    "bandwidth": "Hz",
    "episode_length": "s",
    "duration": "s",
}
WHOLE = ("steps", "round_steps", "environments", "patience", "seeds")
LISTS = ("network", "value_network", "motions", "randomise")
OPTIONAL = ("value_network", "randomise")
"""Lists that may be left open."""
RESIDUAL = "ppo_residual"
"""Settings that ship for models without inverse dynamics."""
MAX_LAYERS, MAX_UNITS = 16, 4096
"""Size of the largest network [1]: 16 MB for each two layers, many times what an arm needs."""


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
        for name, unit in POSITIVE.items():
            positive(name, getattr(self, name), unit)
        for name in WHOLE:
            whole(name, getattr(self, name))
        for name in LISTS:
            values = getattr(self, name)
            if values is None and name in OPTIONAL:
                continue
            if not isinstance(values, (list, tuple)):
                raise InputError(f"expected a list, got {values!r}", where=name)
            object.__setattr__(self, name, tuple(values))
        for name in ("network", "value_network"):
            layers = getattr(self, name) or ()
            for units in layers:
                whole(name, units)
            if len(layers) > MAX_LAYERS or max(layers, default=0) > MAX_UNITS:
                raise InputError(
                    f"expected at most {MAX_LAYERS} layers of at most {MAX_UNITS} units",
                    where=name,
                )
        motions = (*MOTIONS, "random")
        check_known("motion", self.motion, motions, where="motion")
        for name in self.motions:
            check_known("motion", name, motions, where="motions")
        self._check_flags()
        if not isinstance(self.hyperparameters, Mapping):
            raise InputError(
                "expected names with values",
                "write learning_rate: 3.0e-4, ...",
                where="hyperparameters",
            )
        hyperparameters = checked(self.algorithm, self.hyperparameters)
        object.__setattr__(self, "hyperparameters", hyperparameters)
        _ = self.reward, self.randomisation  # they check their own numbers

    def _check_flags(self) -> None:
        """Check the values that are no positive numbers, lists or names."""
        if not isinstance(self.parallel, bool):
            raise InputError(
                f"expected true or false, got {self.parallel!r}", where="parallel"
            )
        is_whole = isinstance(self.seed, int) and not isinstance(self.seed, bool)
        if not is_whole or self.seed < 0:
            raise InputError(
                f"expected a whole number from 0 on, got {self.seed!r}", where="seed"
            )
        is_number = isinstance(self.improvement, (int, float))
        if not is_number or not 0 <= self.improvement < math.inf:
            raise InputError(
                f"expected a number from 0 on [1], got {self.improvement!r}",
                where="improvement",
            )

    @property
    def reward(self) -> Reward:
        """The reward."""
        return Reward(self.tolerance, self.effort, self.smoothness)

    @property
    def randomisation(self) -> Randomisation | None:
        """What is drawn at every reset, or ``None``."""
        if not self.randomise:
            return None
        for name in ("count", "severity"):
            value = getattr(self, name)
            if (
                not isinstance(value, tuple)
                or len(value) != 2
                or not all(isinstance(x, (int, float)) for x in value)
            ):
                raise InputError(
                    f"expected a lowest and a highest number, got {value!r}", where=name
                )
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
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            k: list(v)
            if isinstance(v, tuple)
            else dict(v)
            if isinstance(v, Mapping)
            else v
            for k, v in values.items()
        }


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
    if not isinstance(content, dict):
        raise InputError(
            "expected names with values", "start from a file of agents/training/configs"
        )
    known = [f.name for f in fields(TrainingSettings)]
    for name in content:
        if name not in known:
            raise InputError(
                f"unknown key {name!r}",
                f"{nearest(str(name), known)}known are {', '.join(known)}",
                where=str(name),
            )
    content = {
        k: tuple(v) if k in ("count", "severity") and isinstance(v, list) else v
        for k, v in content.items()
    }
    return TrainingSettings(**{**content, **changed})
