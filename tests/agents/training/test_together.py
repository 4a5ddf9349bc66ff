"""Training and evaluation with environments that are stepped together: the same figures as one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.agents.training.task import Normalisation, Task, episodes, held_out, idle
from gapscope.agents.training.training_loop import Training

from .conftest import short

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")


def test_the_adapter_gives_what_environments_one_by_one_give(task: Task) -> None:
    """Two episodes, the end of the first among them, with the same seeds and actions."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from gapscope.agents.training.vector_adapter import NormalisedArms

    settings = short(episode_length=0.2)
    one = task.simulator(settings)
    figures = Normalisation.measured(one, 0, 0.02, episodes=1)
    both = (
        DummyVecEnv(task.normalised(settings, figures)),
        NormalisedArms(task.simulators(settings), figures),
    )
    rng = np.random.default_rng(0)
    for vector in both:
        vector.seed(7)
    np.testing.assert_array_equal(*(vector.reset() for vector in both))
    ended = 0
    for _ in range(14):
        actions = rng.uniform(-1, 1, (2, 1)).astype(np.float32)
        alone, together = (vector.step(actions) for vector in both)
        for first, second in zip(alone[:3], together[:3], strict=True):
            assert first.dtype == second.dtype
            np.testing.assert_array_equal(first, second)
        for first, second in zip(alone[3], together[3], strict=True):
            last = [x.get("terminal_observation") for x in (first, second)]
            assert (last[0] is None) == (last[1] is None)
            if last[0] is not None:
                ended += 1
                np.testing.assert_array_equal(*last)
                assert first["TimeLimit.truncated"] == second["TimeLimit.truncated"]
    assert ended == 2


def test_evaluations_together_are_those_one_by_one(task: Task) -> None:
    settings = short(motions=("fourier", "point_to_point"), duration=0.4, seeds=2)
    alone = task.simulator(settings, settings.duration)
    motions = held_out(settings, alone)
    together = task.trials(settings, len(motions))
    scores = [episodes(env, idle(alone), motions) for env in (alone, together)]
    assert len(scores[0]) == len(scores[1]) == 4
    for one, other in zip(*scores, strict=True):
        # sums over the arms of a batch may be rounded otherwise than those of one
        assert vars(one) == pytest.approx(vars(other), rel=1e-12)


@pytest.mark.nightly
def test_an_arm_that_cannot_be_stepped_beside_others_is_trained_one_by_one(
    task: Task, tmp_path: Path
) -> None:
    said: list[str] = []
    drawn = {"randomise": ("backlash",), "count": (1, 1)}
    settings = short(steps=128, round_steps=128, **drawn)
    Training(task, settings, tmp_path / "out", said.append).run()
    assert any("one by one: backlash may be drawn" in text for text in said)
