"""Training and evaluation with environments that are stepped together: the same figures as one by one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.agents.training.task import Normalisation, Task
from gapscope.agents.training.training_loop import Training, training_environments

from .conftest import short

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")


def test_the_adapter_gives_what_environments_one_by_one_give(task: Task) -> None:
    """Two episodes, the end of the first among them, with the same seeds and actions; the others in processes."""
    settings = short(episode_length=0.2)
    one = task.simulator(settings)
    figures = Normalisation.measured(one, 0, 0.02, episodes=1)
    both = [
        training_environments(task, replace(settings, parallel=parallel), figures)
        for parallel in (True, False)
    ]
    rng = np.random.default_rng(0)
    for vector in both:
        vector.seed(7)
    np.testing.assert_array_equal(*(vector.reset() for vector in both))
    ended = 0
    for _ in range(14):
        actions = rng.uniform(-1, 1, (2, 1)).astype(np.float32)
        alone, together = (vector.step(actions) for vector in both)
        for first, second in zip(alone[:3], together[:3], strict=True):
            # rewards of processes come in double precision
            np.testing.assert_array_equal(first.astype(second.dtype), second)
        for first, second in zip(alone[3], together[3], strict=True):
            last = [x.get("terminal_observation") for x in (first, second)]
            assert (last[0] is None) == (last[1] is None)
            if last[0] is not None:
                ended += 1
                np.testing.assert_array_equal(*last)
                assert first["TimeLimit.truncated"] == second["TimeLimit.truncated"]
    assert ended == 2
    for vector in both:
        vector.close()


@pytest.mark.nightly
def test_an_arm_that_is_stepped_one_by_one_is_trained(
    task: Task, tmp_path: Path
) -> None:
    drawn = {"randomise": ("backlash",), "count": (1, 1)}
    settings = short(steps=128, round_steps=128, **drawn)
    assert len(Training(task, settings, tmp_path / "out").run().curve) == 2
