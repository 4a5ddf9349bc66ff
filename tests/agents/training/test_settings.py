"""Settings of a training: what ships is whole, and what is wrong is told."""

from __future__ import annotations

import pytest

from gapscope.agents.training.training_settings import (
    ALGORITHMS,
    RESIDUAL,
    from_plain,
    read_settings,
)


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
