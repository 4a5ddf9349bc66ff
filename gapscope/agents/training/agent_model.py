"""A trained agent, read to be evaluated beside models."""

from __future__ import annotations

from pathlib import Path

from gapscope.agents.agent_controller import AgentModel
from gapscope.agents.training.policy import DOCUMENT, read_agent
from gapscope.agents.training.task import Task
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import is_file
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import control
from gapscope.envs.episode import LOOK_AHEAD, SUB_STEPS, TIME_STEP
from gapscope.provenance import sha256


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
    reach = settings.action_reach if settings.action == "residual" else None
    trained_with = control(
        arm, body, workspace(body), settings.action, None, settings.bandwidth, reach
    )
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
