"""A light arm with one joint, on which agents learn within seconds, and short settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from arms import ROD, chain, changed

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.nominal import NominalArm


def rod(folder: Path, joint: str = "hinge") -> NominalArm:
    """2 kg at 0.5 m about a horizontal axis, a rotor of 0.4 kg m^2: 1 kg m^2, and gravity of -9.81 cos q N m."""
    links = changed(
        [ROD], joint=joint, inertia="0.01 0.1 0.1", limit="-3 3 60 9", kind="revolute"
    )
    return chain(folder, joint, *links, armature=[0.4])


@pytest.fixture
def arm(tmp_path: Path) -> NominalArm:
    """The rod."""
    return rod(tmp_path)


@pytest.fixture
def task(arm: NominalArm) -> Task:
    """PD alone, tried on the nominal rod."""
    return Task.of("pd", arm, ())


def short(algorithm: str = "ppo", **changed: Any) -> TrainingSettings:
    """Settings of a training that takes seconds."""
    values = {
        "algorithm": algorithm,
        "steps": 512,
        "round_steps": 256,
        "environments": 2,
        "network": (16,),
        "motion": "fourier",
        "motions": ("fourier",),
        "episode_length": 1.0,
        "duration": 1.0,
        "bandwidth": 2.0,
        "action_reach": 0.1,
        "randomise": (),
        "tolerance": 0.02,
        "exploration": 0.4,
        "smoothness": 0.01,
    }
    own = {"ppo": PPO, "sac": OFF_POLICY | {"ent_coef": 0.003}}
    values["hyperparameters"] = own.get(algorithm, OFF_POLICY)
    return TrainingSettings(**{**values, **changed})


PPO = {"n_steps": 64, "n_epochs": 5, "batch_size": 64}
PPO |= {"learning_rate": 3e-3, "gamma": 0.8}
OFF_POLICY = {"learning_starts": 200, "buffer_size": 5000, "batch_size": 64}
OFF_POLICY |= {"learning_rate": 2e-3, "gamma": 0.8}
OFF_POLICY |= {"train_freq": 2, "gradient_steps": 2}
