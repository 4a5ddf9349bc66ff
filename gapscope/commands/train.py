"""The command ``gapscope train``: an agent on top of a model's feedforward."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gapscope.commands.options import Results, RobotOption
from gapscope.terminal import Progress, say, wrote

Model = Annotated[
    str,
    typer.Argument(
        help="pd, gravity, nominal, a corrected.yaml, or an identification.json",
        metavar="MODEL",
    ),
]
HiddenEffects = Annotated[
    Path | None,
    typer.Option(
        help="hidden effects of the arm that the agent is tried on, as corrected.yaml; training never sees them",
        metavar="FILE",
    ),
]
Agent = Annotated[
    str | None,
    typer.Option(
        help="ppo, ppo_residual, sac, td3, or a YAML file with settings; default: ppo, on pd and gravity ppo_residual",
        metavar="NAME|FILE",
    ),
]
Steps = Annotated[
    int | None, typer.Option(help="actions to train for; default: the settings'")
]
Seed = Annotated[
    int | None, typer.Option(min=0, help="of weights, motions and exploration")
]
TrainingEngine = Annotated[
    str | None,
    typer.Option(help="mujoco (default: all environments together) or pybullet"),
]
Parallel = Annotated[
    bool,
    typer.Option("--parallel", help="step each environment in a process of its own"),
]
Randomise = Annotated[
    bool,
    typer.Option(
        "--randomise",
        help="draw any effects around the model in every episode, not only what its diagnosis leaves open",
    ),
]
Tune = Annotated[
    int,
    typer.Option(
        min=0,
        help="search hyperparameters in so many short trainings instead",
        metavar="TRIALS",
    ),
]
Again = Annotated[
    bool,
    typer.Option(
        "--again", help="replace what the folder holds of an earlier training"
    ),
]


def train(
    model: Model,
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: HiddenEffects = None,
    agent: Agent = None,
    steps: Steps = None,
    seed: Seed = None,
    engine: TrainingEngine = None,
    parallel: Parallel = False,
    randomise: Randomise = False,
    tune: Tune = 0,
    again: Again = False,
) -> None:
    """Train an agent on top of a model's feedforward.

    It learns in the simulator made from that model, and is tried on an arm with hidden effects.
    """
    from gapscope.agents.training.task import ROUGH
    from gapscope.agents.training.training_settings import RESIDUAL, read_settings
    from gapscope.commands.training_files import train_files

    agent = agent or (RESIDUAL if model in ROUGH else "ppo")
    settings = read_settings(
        agent, steps=steps, seed=seed, engine=engine, parallel=parallel or None
    )
    if randomise:
        settings = settings.randomised()
    with Progress(model) as progress:
        content, paths = train_files(
            model,
            robot,
            effects,
            settings,
            out,
            again=again,
            trials=tune,
            progress=progress,
        )
    if content:
        say(*_improvement(content))
    wrote(*paths)


def _improvement(content: dict[str, Any]) -> list[str]:
    """Which agent is kept and why, and the joint errors before and after, in the simulator and on the hidden arm."""
    places = {
        "simulator": "in the simulator made from the model",
        "hidden": "on the hidden arm",
    }
    lines = [content["reason"], "the agent after the last round is in last/"]
    for key, place in places.items():
        states = {name: content[name][key] for name in ("untrained", "kept", "last")}
        if all(states.values()):
            texts = [f"{_joint_error(score)} {name}" for name, score in states.items()]
            lines.append(f"joint error {place}: {', '.join(texts)}")
    return lines


def _joint_error(score: dict[str, Any]) -> str:
    error = score["joint_error"]
    return "not tracked to the end" if error is None else f"{1e3 * error:.3g} mrad"
