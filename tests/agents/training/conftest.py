"""A light arm with one joint, on which agents learn within seconds, and short settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.nominal import NominalArm

URDF = """<robot name="rod"><link name="base"/>
  <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{joint}" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="60" velocity="9"/></joint></robot>"""


def rod(folder: Path, joint: str = "hinge") -> NominalArm:
    """2 kg at 0.5 m about a horizontal axis, a rotor of 0.4 kg m^2: 1 kg m^2, and gravity of -9.81 cos q N m."""
    urdf = folder / f"{joint}.urdf"
    urdf.write_text(URDF.format(joint=joint))
    return NominalArm("rod", urdf, (joint,), armature=np.array([0.4]))


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
    values: dict[str, Any] = {
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
        "tolerance": 0.02,
        "exploration": 0.4,
        "smoothness": 0.01,
    }
    if algorithm == "ppo":
        values["hyperparameters"] = {
            "n_steps": 64,
            "n_epochs": 5,
            "batch_size": 64,
            "learning_rate": 3e-3,
            "gamma": 0.8,
        }
    else:
        values["hyperparameters"] = {
            "learning_starts": 200,
            "buffer_size": 5000,
            "batch_size": 64,
            "learning_rate": 2e-3,
            "gamma": 0.8,
            "train_freq": 2,
            "gradient_steps": 2,
        }
        if algorithm == "sac":
            values["hyperparameters"]["ent_coef"] = 0.003
    return TrainingSettings(**{**values, **changed})
