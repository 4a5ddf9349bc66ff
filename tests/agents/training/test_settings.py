"""Settings of a training: what ships is whole, and what is wrong is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from gapscope.agents.training.training_settings import (
    ALGORITHMS,
    RESIDUAL,
    from_plain,
    read_settings,
)
from gapscope.arm.errors import InputError


@pytest.mark.parametrize("name", [*ALGORITHMS, RESIDUAL])
def test_shipped_settings_are_whole(name: str) -> None:
    settings = read_settings(name, seed=3)
    assert settings.algorithm == name.split("_")[0] and settings.seed == 3
    assert 0.9 * settings.steps < settings.total <= settings.steps
    assert settings.rounds * settings.round_length >= settings.total
    assert from_plain(settings.plain()) == settings


def test_no_more_steps_than_asked() -> None:
    """The last round is shorter; what is collected at once, 32 times 32 actions, is the least."""
    assert read_settings(RESIDUAL, steps=16_384).total == 16_384
    assert read_settings(RESIDUAL, steps=16_384).rounds == 2
    assert read_settings(RESIDUAL, steps=5000).total == 4096
    assert read_settings(RESIDUAL, steps=10).total == 1024


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("algoritm: ppo", "algoritm.*\n.*did you mean 'algorithm'"),
        ("algorithm: a2c", "algorithm: unknown algorithm 'a2c'"),
        ("steps: many", "steps: expected a whole number"),
        ("steps: 0", "steps: expected a whole number"),
        ("network: 64", "network: expected a list"),
        ("bandwidth: -1", "bandwidth: expected a number above zero"),
        ("action: torqe", "did you mean 'torque'"),
        ("motions: [fourie]", "did you mean 'fourier'"),
        ("hyperparameters: {learning_rat: 0.1}", "did you mean 'learning_rate'"),
        (
            "hyperparameters: {n_steps: 1.5}",
            "hyperparameters.n_steps: expected a whole number",
        ),
        (
            "hyperparameters: {learning_rate: fast}",
            "expected a number from 0 on, got 'fast'",
        ),
        ("hyperparameters: 3", "expected names with values"),
        ("{algorithm: sac, hyperparameters: {ent_coef: automatic_}}", "ent_coef"),
        ("randomise: [payloads]", "did you mean 'payload'"),
        ("{randomise: [payload], severity: 2}", "severity"),
        ("tolerance: 0", "tolerance"),
        ("seed: -1", "seed"),
        ("parallel: 3", "parallel: expected true or false"),
        ("[1, 2]", "expected names with values"),
        ("a: [", "not valid YAML"),
    ],
)
def test_bad_settings_are_told_with_file_and_field(
    text: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "agent.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=rf"(?s)agent\.yaml.*{message}"):
        read_settings(file)


def test_unknown_agents_are_told() -> None:
    with pytest.raises(InputError, match="did you mean 'ppo'"):
        read_settings("pppo")
    with pytest.raises(InputError, match="no such file"):
        read_settings("missing.yaml")
