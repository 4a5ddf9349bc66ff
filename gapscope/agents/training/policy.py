"""A trained agent as files: written with what it was made from, read with checks, and evaluated beside models."""

from __future__ import annotations

import platform
import shutil
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from gapscope.agents.models import AgentModel
from gapscope.agents.training.task import LARGEST, Normalisation, Task
from gapscope.agents.training.training_loop import (
    NORMALISATION,
    Trained,
    make_learner,
    read_weights,
)
from gapscope.agents.training.training_settings import TrainingSettings, from_plain
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import (
    LARGEST_IN_MEMORY,
    check_file,
    is_file,
    is_folder,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import (
    field,
    plain,
    read_json,
    schema_fault,
    write_json,
)
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import control
from gapscope.envs.environment import LOOK_AHEAD, SUB_STEPS, TIME_STEP
from gapscope.provenance import library_versions, sha256

POLICY, DOCUMENT = "policy.zip", "agent.json"
LAST = "last"
"""Folder, beside the agent that is kept, of the one after the last round."""
LIBRARIES = ("gapscope", "numpy", "torch", "stable_baselines3")
_REMEDY = "give the folder that gapscope train wrote, or train again with --again"


class TrainedAgent(NamedTuple):
    """A trained agent.

    Attributes:
        document: content of ``agent.json``.
        settings: of its training.
        normalisation: what it sees.
        learner: of stable-baselines3, with its weights.
    """

    document: dict[str, Any]
    settings: TrainingSettings
    normalisation: Normalisation
    learner: Any

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Action in -1 .. 1, of an observation as the environment gives it."""
        seen = self.normalisation(observation)
        return np.asarray(self.learner.predict(seen, deterministic=True)[0])


def write_agent(task: Task, trained: Trained, folder: Path) -> dict[str, Any]:
    """Write the agent that is kept, and the last one into the folder ``last`` beside it; returns ``agent.json``.

    Each has ``policy.zip``, ``normalisation.npz`` and, as the last, ``agent.json``.

    Raises:
        GapscopeError: a file cannot be written.
    """
    env = task.simulator(trained.settings)
    layout = {name: part.stop - part.start for name, part in env.layout.slices.items()}
    size = env.setup.control.size
    env.close()
    content = {
        "schema": 1,
        "robot": task.arm.name,
        "joints": list(task.arm.joints),
        "model": task.name,
        "observation": layout,
        "actions": size,
        "settings": trained.settings.plain(),
        "steps": trained.curve[-1]["steps"],
        "untrained": trained.curve[0],
        "last": trained.curve[-1],
        "reason": trained.reason,
        "stopped_early": trained.stopped,
        "versions": {
            "python": platform.python_version(),
            **library_versions(LIBRARIES),
        },
    }
    _write(content, trained, len(trained.curve) - 1, trained.last, folder / LAST)
    return _write(content, trained, trained.best, trained.weights, folder)


def _write(
    content: dict[str, Any], trained: Trained, place: int, weights: Path, folder: Path
) -> dict[str, Any]:
    """Write the agent at a place of the curve; the content of its document."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / POLICY) as aside:
        shutil.copyfile(weights, aside)
    trained.normalisation.write(folder / NORMALISATION)
    files = {name: sha256(folder / name) for name in (POLICY, NORMALISATION)}
    whole = content | {"kept": trained.curve[place], "files": files}
    found = plain(whole, null_if_not_finite=True)
    write_json(found, folder / DOCUMENT)
    return found


def read_agent(folder: Path | str, arm: NominalArm) -> TrainedAgent:
    """Read a trained agent for an arm.

    Raises:
        InputError: no trained agent there, a file that was cut short or changed, or an agent of another arm.
    """
    folder = Path(folder)
    path = folder / DOCUMENT
    if is_folder(folder) and not is_file(path):
        raise InputError(
            f"holds no trained agent (no file {DOCUMENT})", _REMEDY, file=folder
        )
    content = read_json(path, _REMEDY)
    # sizes beyond any agent's are refused before networks are made
    fault = schema_fault(content, "agent")
    if fault is not None:
        raise InputError(
            f"is no document of a trained agent ({fault.message})",
            _REMEDY,
            file=path,
            where=field(fault.absolute_path),
        )
    if content["joints"] != list(arm.joints):
        raise InputError(
            f"is an agent of an arm with the joints {', '.join(content['joints'])}, not {', '.join(arm.joints)}",
            "train one for this arm, or give its arm as --robot",
            file=path,
        )
    for name in (POLICY, NORMALISATION):
        check_file(folder / name, _REMEDY, LARGEST_IN_MEMORY)
        if sha256(folder / name) != content["files"][name]:
            raise InputError(
                "was cut short or changed since it was trained",
                _REMEDY,
                file=folder / name,
            )
    try:
        settings = from_plain(content["settings"])
    except InputError as error:
        raise error.at(path, "settings") from None
    normalisation = Normalisation.read(folder / NORMALISATION)
    size, actions = sum(content["observation"].values()), content["actions"]
    try:
        with warnings.catch_warnings():
            # of batches: it is not trained here
            warnings.simplefilter("ignore", UserWarning)
            learner = make_learner(settings, _Spaces(size, actions))
    except AssertionError as error:  # of stable-baselines3 on its hyperparameters
        raise InputError(
            f"its hyperparameters do not fit together ({error})",
            _REMEDY,
            file=path,
            where="settings",
        ) from None
    read_weights(learner, folder / POLICY)
    return TrainedAgent(content, settings, normalisation, learner)


class _Spaces(gymnasium.Env):
    """An environment of which only the spaces are used."""

    def __init__(self, observation: int, actions: int) -> None:
        self.observation_space = Box(-LARGEST, LARGEST, (observation,), np.float32)
        self.action_space = Box(-1.0, 1.0, (actions,), np.float32)


def read_agent_model(folder: Path, arm: NominalArm) -> AgentModel:
    """The agent of a folder that ``gapscope train`` wrote, with the model that it was trained on top of.

    Raises:
        InputError: no agent of this arm, or its model's file is not where it was.
    """
    agent = read_agent(folder, arm)
    source = str(agent.document["model"])
    path = Path(source)
    if path.suffix and not is_file(path):
        raise InputError(
            f"was trained on top of {source}, which is not there",
            "run this in the folder in which it was trained, or put the model's file back",
            file=folder / DOCUMENT,
            where="model",
        )
    body, settings = RigidBody(arm), agent.settings
    loop = settings.action, None, settings.bandwidth, settings.reach
    trained_with = control(arm, body, workspace(body), *loop)
    try:
        model = Task.of(source, arm).model()
    except InputError as error:
        raise (
            error.at(folder / DOCUMENT, "model") if error.file is None else error
        ) from None
    return AgentModel(
        policy=agent.act,
        model=model,
        control=trained_with,
        look_ahead=LOOK_AHEAD,
        period=TIME_STEP * SUB_STEPS,
        digest=sha256(folder / DOCUMENT),
    )
