"""Agents learn, the same way every time, and go on where they were interrupted."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sweeps import daily, nightly

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench, evaluate
from gapscope.agents.training.policy import (
    LAST,
    read_agent,
    read_agent_model,
    write_agent,
)
from gapscope.agents.training.task import Task, held_out, idle, judge
from gapscope.agents.training.training_loop import (
    CHECKPOINTS,
    WEIGHTS,
    Training,
    read_checkpoint,
)
from gapscope.agents.training.training_settings import ALGORITHMS, read_settings
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import carried

from .conftest import PPO, rod, short

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

SHORT = short(steps=128, round_steps=128)
PAYLOAD = carried(1.0, (0.5, 0.0, 0.0))


def weights(folder: Path) -> dict[str, np.ndarray]:
    """All networks and optimisers of the last checkpoint."""
    from stable_baselines3.common.save_util import load_from_zip_file
    from torch import is_tensor
    from torch.utils._pytree import keystr, tree_flatten_with_path

    found = read_checkpoint(folder / CHECKPOINTS)
    assert found is not None
    parameters = load_from_zip_file(found[0] / WEIGHTS, load_data=False)[1]

    leaves, _ = tree_flatten_with_path(parameters)
    return {keystr(path): leaf.numpy() for path, leaf in leaves if is_tensor(leaf)}


def same(one: Path, other: Path) -> None:
    a, b = weights(one), weights(other)
    assert a.keys() == b.keys() and a
    for name, value in a.items():
        np.testing.assert_array_equal(value, b[name], err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "steps"), [("ppo", 5120), nightly("sac", 3600)])
def test_agents_learn_to_hold_a_rod_up(
    task: Task, algorithm: str, steps: int, tmp_path: Path
) -> None:
    settings = short(algorithm, steps=steps, round_steps=steps // 2)
    trained = Training(task, settings, tmp_path / "out").run()
    first, best = trained.curve[0], trained.curve[trained.best]
    assert best["simulator"]["joint_error"] < 0.6 * first["simulator"]["joint_error"]
    assert best["hidden"] is not None and first["hidden"] is not None
    assert best["hidden"]["joint_error"] < 0.6 * first["hidden"]["joint_error"]
    assert best["simulator"]["reward"] > first["simulator"]["reward"] + 0.05


@pytest.mark.slow
def test_an_agent_on_a_wrong_model_is_kept_and_helps_the_hidden_arm(
    arm: NominalArm, tmp_path: Path
) -> None:
    """Trained on arms with effects drawn around the model; in the model's own simulator nothing would be left."""
    settings = short(
        action="gains",
        randomise=None,
        network=(),
        value_network=(32,),
        environments=8,
        steps=6144,
        round_steps=2048,
        seeds=6,
        tolerance=0.005,
        exploration=0.5,
        hyperparameters=PPO | {"batch_size": 512, "learning_rate": 1e-2, "gamma": 0.9},
    )
    task = Task.of("nominal", arm, (PAYLOAD,))
    trained = Training(task, settings, tmp_path).run()
    first, kept = trained.curve[0], trained.curve[trained.best]
    assert trained.best and "drawn around the model" in trained.reason
    assert first["hidden"] is not None and kept["hidden"] is not None
    assert kept["hidden"]["joint_error"] < 0.85 * first["hidden"]["joint_error"]
    content = write_agent(task, trained, tmp_path)
    assert content["kept"]["steps"] == kept["steps"]
    last = read_agent(tmp_path / LAST, arm)
    assert last.document["kept"]["steps"] == trained.curve[-1]["steps"] == 6144
    # where the model is right, the agent adds nothing
    right = task.trials(short(action="gains"), 6)
    motions = held_out(settings, right.setup.space)
    own, alone = (judge(right, p, motions) for p in (trained.policy, idle(right)))
    assert own["joint_error"] < 1.02 * alone["joint_error"]


@pytest.mark.parametrize("algorithm", daily(ALGORITHMS, "sac", "td3"))
def test_the_untrained_agent_does_nothing(
    task: Task, algorithm: str, tmp_path: Path
) -> None:
    training = Training(task, short(algorithm), tmp_path)
    trained = training.run(rounds=0)
    assert len(trained.curve) == 1 and trained.best == 0
    env = task.simulator(short(algorithm))
    np.testing.assert_array_equal(trained.policy(env.reset(seed=1)[0]), 0.0)
    env.close()


@pytest.mark.parametrize("algorithm", daily(("ppo", "sac"), "ppo"))
def test_interrupted_and_resumed_equals_uninterrupted_bit_by_bit(
    task: Task, algorithm: str, tmp_path: Path
) -> None:
    settings = short(algorithm, steps=256, round_steps=128)
    whole = Training(task, settings, tmp_path / "whole").run()
    Training(task, settings, tmp_path / "parts").run(rounds=1)
    resumed = Training(task, settings, tmp_path / "parts").run()
    assert resumed.curve == whole.curve
    same(tmp_path / "whole", tmp_path / "parts")


def test_hidden_effects_do_not_reach_training(arm: NominalArm, tmp_path: Path) -> None:
    for name, hidden in (("none", ()), ("payload", (PAYLOAD,))):
        Training(Task.of("pd", arm, hidden), SHORT, tmp_path / name).run()
    same(tmp_path / "none", tmp_path / "payload")


def test_training_ends_early_for_want_of_improvement(
    task: Task, tmp_path: Path
) -> None:
    settings = replace(SHORT, steps=2048, patience=1, improvement=1.0)
    trained = Training(task, settings, tmp_path).run()
    assert trained.stopped and len(trained.curve) == 2 and trained.best == 0


def test_a_checkpoint_cut_short_or_of_other_settings_is_refused(
    task: Task, tmp_path: Path
) -> None:
    Training(task, SHORT, tmp_path).run()
    with pytest.raises(InputError, match="other settings: steps"):
        Training(task, short(steps=512), tmp_path).run()
    found = read_checkpoint(tmp_path / CHECKPOINTS)
    assert found is not None
    file = found[0] / WEIGHTS
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"cut short(.|\n)*--again"):
        Training(task, SHORT, tmp_path).run()


@pytest.mark.parametrize("name", ["stable_baselines3", "torch"])
def test_what_is_not_installed_is_told(
    task: Task, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=rf"{name}(.|\n)*gapscope\[learn\]"):
        Training(task, short(), tmp_path)


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
def test_hyperparameters_are_searched(task: Task, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    from gapscope.agents.training.training_loop import tune

    file = tune(task, SHORT, 2, tmp_path)
    assert read_settings(file).steps == 128
    assert tune(task, SHORT, 2, tmp_path) == file


def test_an_agent_is_read_back_evaluated_beside_models_and_checked(
    task: Task, arm: NominalArm, tmp_path: Path
) -> None:
    """Of the first round it is kept as it was: it outputs zero, and tracks as its model does."""
    out = tmp_path / "out"
    trained = Training(task, SHORT, out).run()
    content = write_agent(task, trained, out)
    agent, env = read_agent(out, arm), task.simulator(SHORT)
    observation = env.reset(seed=3)[0]
    np.testing.assert_array_equal(agent.act(observation), trained.policy(observation))
    env.close()
    plan = EvaluationPlan(("fourier",), ("none",), (0,), duration=0.5)
    models = {"pd": None, "agent": read_agent_model(out, arm)}
    episodes, margins = evaluate(models, TrackingBench(arm, (), plan))
    pd, own = ({**episode, "model": ""} for episode in episodes)
    kept = trained.curve[trained.best]["steps"]
    assert (own == pd) == (kept == 0) and np.isfinite(own["joint_error"])
    assert set(margins) == {(name, plan.engines[0]) for name in models}

    def refused(message: str, read: Any = read_agent, **changed: Any) -> None:
        (out / "agent.json").write_text(json.dumps(content | changed))
        with pytest.raises(InputError, match=message):
            read(out, arm)

    with pytest.raises(InputError, match="hinge, not elbow"):
        read_agent(out, rod(tmp_path, "elbow"))
    refused("which is not there", read_agent_model, model="gone/corrected.yaml")
    policy = out / "policy.zip"
    policy.write_bytes(policy.read_bytes()[:500])
    refused("cut short")
    refused("no document of a trained agent", files={})
    (out / "agent.json").unlink()
    with pytest.raises(InputError, match="no trained agent"):
        read_agent(out, arm)
