"""The algorithms of stable-baselines3: made, seeded, and their state as files without pickled code."""

from __future__ import annotations

import math
import random
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.errors import GapscopeError, InputError

REPLAY = (
    "observations",
    "next_observations",
    "actions",
    "rewards",
    "dones",
    "timeouts",
)
"""Arrays of a replay buffer."""
PPO_EPSILON = 1e-5
"""Epsilon of Adam for PPO, as stable-baselines3 sets it if nothing is said of the optimiser."""


def check_installed() -> None:
    """Check that torch and stable-baselines3 are there.

    Raises:
        InputError: one of them is not.
    """
    try:
        import stable_baselines3  # noqa: F401
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"agents need {error.name}, which is not installed",
            "pip install 'gapscope[learn]'",
            where="train",
        ) from None


def make_learner(
    settings: TrainingSettings, environment: Any, events: Path | None = None
) -> Any:
    """A learner whose untrained agent does nothing: the deterministic action is exactly zero.

    Args:
        settings: of the training.
        environment: a vector environment, or one that has the spaces.
        events: folder of TensorBoard's events, if tensorboard is installed.
    """
    check_installed()
    import stable_baselines3
    import torch
    from stable_baselines3.common.logger import Logger, configure
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    torch.set_num_threads(1)  # sums of several threads are not the same bit by bit
    seed_all(settings.seed, 0)
    kind = getattr(stable_baselines3, settings.algorithm.upper())
    if issubclass(kind, OffPolicyAlgorithm):
        kind = type(f"Gentle{kind.__name__}", (_Gentle, kind), {})
    critic = "vf" if settings.algorithm == "ppo" else "qf"
    value = settings.network
    if settings.value_network is not None:
        value = settings.value_network
    # networks are small: one call for all weights takes a fraction of the time of one for each
    adam: dict[str, Any] = {"fused": True}
    options: dict[str, Any] = {
        "policy_kwargs": {
            "net_arch": {"pi": list(settings.network), critic: list(value)},
            "optimizer_kwargs": adam,
        },
        **settings.hyperparameters,
    }
    size = environment.action_space.shape[0]
    if settings.algorithm == "ppo":
        adam["eps"] = PPO_EPSILON
        options["policy_kwargs"]["log_std_init"] = math.log(settings.exploration)
    elif settings.algorithm == "td3":
        options["action_noise"] = NormalActionNoise(
            np.zeros(size), settings.exploration * np.ones(size)
        )
    learner = kind("MlpPolicy", environment, device="cpu", **options)
    if events is not None and find_spec("tensorboard") is not None:
        learner.set_logger(configure(str(events), ["tensorboard"]))
    else:
        learner.set_logger(Logger(folder=None, output_formats=[]))
    _hush(learner, settings, torch)
    return learner


class _Gentle:
    """Explores about the policy from the first action on; uniform actions would throw the arm about."""

    def _sample_action(self, learning_starts: int, *more: Any, **options: Any) -> Any:
        return super()._sample_action(0, *more, **options)  # type: ignore[misc]


def _hush(learner: Any, settings: TrainingSettings, torch: Any) -> None:
    """Set the last layer of the policy to zero, the value of PPO to perfect tracking, and the exploration of SAC."""
    policy = learner.policy
    with torch.no_grad():
        if settings.algorithm == "ppo":
            heads = [policy.action_net]
        elif settings.algorithm == "sac":
            heads = [policy.actor.mu, policy.actor.log_std]
        else:
            heads = [policy.actor.mu[-2], policy.actor_target.mu[-2]]
        for head in heads:
            head.weight.zero_()
            head.bias.zero_()
        if settings.algorithm == "ppo":
            # perfect tracking earns 1 an action; from 0 the value's errors would drown what actions do at first
            policy.value_net.weight.zero_()
            policy.value_net.bias.fill_(1 / (1 - learner.gamma))
        if settings.algorithm == "sac":
            policy.actor.log_std.bias.fill_(math.log(settings.exploration))


def seed_all(seed: int, number: int) -> int:
    """Seed Python, numpy and torch from a seed and a round's number; returns a seed for the environments."""
    import torch

    state = np.random.SeedSequence((seed, number)).generate_state(4)
    random.seed(int(state[0]))
    np.random.seed(int(state[1]))  # stable-baselines3 draws from the global states
    torch.manual_seed(int(state[2]))
    return int(state[3] >> 1)


def write_weights(learner: Any, path: Path) -> None:
    """Write networks and optimisers as a zip of stable-baselines3 that holds tensors alone."""
    from stable_baselines3.common.save_util import recursive_getattr, save_to_zip_file

    names = learner._get_torch_save_params()[1]
    variables = {name: recursive_getattr(learner, name) for name in names}
    save_to_zip_file(
        path, params=learner.get_parameters(), pytorch_variables=variables or None
    )


def read_weights(learner: Any, path: Path) -> None:
    """Put the weights of a file into a learner.

    Raises:
        InputError: the file is missing, cut short, no policy, or of other networks.
    """
    from stable_baselines3.common.save_util import load_from_zip_file, recursive_setattr

    remedy = "take the file from another copy, or train the agent again with --again"
    try:
        _, parameters, variables = load_from_zip_file(
            path, device="cpu", load_data=False
        )
        if not parameters:
            raise ValueError("it holds no networks")
        learner.set_parameters(parameters, exact_match=True, device="cpu")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})", remedy, file=path
        ) from None
    except Exception as error:  # whatever zip and torch say of a broken file
        said = str(error).split("\n")[0]
        raise InputError(
            f"is no policy of these settings, or was cut short ({said})",
            remedy,
            file=path,
        ) from None
    for name, value in (variables or {}).items():
        recursive_setattr(learner, f"{name}.data", value.data)


def write_replay(learner: Any, path: Path) -> None:
    """Write the replay buffer of SAC or TD3 as NPZ."""
    buffer = learner.replay_buffer
    rows = slice(None) if buffer.full else slice(0, buffer.pos)
    arrays = {name: getattr(buffer, name)[rows] for name in REPLAY}
    np.savez(path, allow_pickle=False, pos=buffer.pos, full=buffer.full, **arrays)


def read_replay(learner: Any, path: Path) -> None:
    """Put a replay buffer back."""
    buffer = learner.replay_buffer
    try:
        with np.load(path, allow_pickle=False) as content:
            for name in REPLAY:
                getattr(buffer, name)[: len(content[name])] = content[name]
            buffer.pos, buffer.full = int(content["pos"]), bool(content["full"])
    except (OSError, ValueError, KeyError) as error:
        raise GapscopeError(
            f"{path}: is no replay buffer ({error})", "train again with --again"
        ) from None
