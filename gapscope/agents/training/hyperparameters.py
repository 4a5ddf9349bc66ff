"""The hyperparameters of each algorithm that a settings file may name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest
from gapscope.envs.arguments import whole

WHOLE, NUMBER, ENTROPY = (
    "a whole number from 1 on",
    "a number from 0 on",
    "a number, auto, or auto_ and a number",
)
COUNT = "a whole number from 0 on"
_COMMON = {"learning_rate": NUMBER, "gamma": NUMBER, "batch_size": WHOLE}
_REPLAY = {
    "buffer_size": WHOLE,
    "learning_starts": COUNT,
    "tau": NUMBER,
    "train_freq": WHOLE,
    "gradient_steps": WHOLE,
}
KNOWN: dict[str, dict[str, str]] = {
    "ppo": {
        **_COMMON,
        "n_steps": WHOLE,
        "n_epochs": WHOLE,
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
        "policy_delay": WHOLE,
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
        if known[name] == WHOLE:
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
