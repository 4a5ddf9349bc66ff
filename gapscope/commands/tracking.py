"""The commands about feedforward and agents: evaluate and train."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from gapscope.commands.options import Results, RobotOption
from gapscope.terminal import Progress, console, log, wrote


def evaluate(
    ctx: typer.Context,
    models: Annotated[
        list[str],
        typer.Argument(
            help="pd, gravity, nominal, a corrected.yaml, or an identification.json; each may be called NAME=...",
            metavar="MODEL...",
        ),
    ],
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="what the arm that is tracked has beyond the nominal one, as corrected.yaml",
            metavar="FILE",
        ),
    ] = None,
    engine: Annotated[
        str, typer.Option(help="pybullet, mujoco or dart; several with commas")
    ] = "pybullet",
    motions: Annotated[
        str, typer.Option(help="motions, with commas between them")
    ] = "fourier,pick,place,weld_seam",
    disturbances: Annotated[
        str, typer.Option(help="none, push or noise; several with commas")
    ] = "none,push",
    seeds: Annotated[int, typer.Option(min=1, help="how many of each motion")] = 3,
    duration: Annotated[float, typer.Option(help="of each motion [s]")] = 4.0,
    bandwidth: Annotated[float, typer.Option(help="of the control loop [Hz]")] = 4.0,
    damping: Annotated[float, typer.Option(help="its damping ratio")] = 0.7,
    law: Annotated[
        str,
        typer.Option(
            help="feedforward (the model beside PD), or computed (the model inside the loop)"
        ),
    ] = "feedforward",
    env: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            help="YAML file with robot, effects, engine, motions, bandwidth, ...; or gapscope/ArmTracking-v0. Options "
            "that are given win",
            metavar="FILE",
        ),
    ] = None,
    again: Annotated[
        bool,
        typer.Option(
            "--again", help="begin anew, also where an earlier run was interrupted"
        ),
    ] = False,
) -> None:
    """Evaluate models by how well an arm is tracked with them."""
    from gapscope.agents.evaluation import EvaluationPlan
    from gapscope.agents.gains import Tuning
    from gapscope.commands.environment_file import chosen
    from gapscope.commands.evaluate import evaluate_files
    from gapscope.reports.evaluation.table import tables

    arm, given, unused = chosen(env, ctx)
    if unused:
        log.print(
            f"note: {env}: {', '.join(unused)} have no say here",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    plan = EvaluationPlan(
        _names(given["motions"]),
        _names(given["disturbances"]),
        tuple(range(given["seeds"])),
        _names(given["engine"]),
        given["duration"],
        Tuning(given["bandwidth"], given["damping"]),
        given["law"],
    )
    with Progress(arm if isinstance(arm, str) else arm.name) as progress:
        content, lines, paths = evaluate_files(
            models, arm, given["effects"], plan, out, progress, again=again
        )
    console.print(tables(lines, content))
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        console.print(
            f"rank correlation of torque error and joint error: {correlation:.2f}",
            highlight=False,
        )
    wrote(*paths)


def train(
    model: Annotated[
        str,
        typer.Argument(
            help="pd, gravity, nominal, a corrected.yaml, or an identification.json",
            metavar="MODEL",
        ),
    ],
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="hidden effects of the arm that the agent is tried on, as corrected.yaml; training never sees them",
            metavar="FILE",
        ),
    ] = None,
    agent: Annotated[
        str,
        typer.Option(
            help="ppo, sac, td3, or a YAML file with settings", metavar="NAME|FILE"
        ),
    ] = "ppo",
    steps: Annotated[
        int | None, typer.Option(help="actions to train for; default: the settings'")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="of weights, motions and exploration")
    ] = None,
    engine: Annotated[str | None, typer.Option(help="pybullet, mujoco or dart")] = None,
    parallel: Annotated[
        bool,
        typer.Option(
            "--parallel", help="step each environment in a process of its own"
        ),
    ] = False,
    randomise: Annotated[
        bool,
        typer.Option(
            "--randomise", help="draw other effects around the model in every episode"
        ),
    ] = False,
    tune: Annotated[
        int,
        typer.Option(
            min=0,
            help="search hyperparameters in so many short trainings instead",
            metavar="TRIALS",
        ),
    ] = 0,
    again: Annotated[
        bool,
        typer.Option(
            "--again", help="replace what the folder holds of an earlier training"
        ),
    ] = False,
) -> None:
    """Train an agent on top of a model's feedforward.

    It learns in the simulator made from that model, and is tried on an arm with hidden effects.
    """
    from gapscope.agents.training.training_settings import read_settings
    from gapscope.commands.train import train_files

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
    for line in _learnt(content) if content else ():
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrote(*paths)


def _learnt(content: dict[str, Any]) -> list[str]:
    """Joint error before and after training, in the simulator and on the hidden arm."""
    lines = []
    for part, where in (
        ("simulator", "in the simulator made from the model"),
        ("hidden", "on the hidden arm"),
    ):
        scores = [content[key][part] for key in ("untrained", "kept")]
        if None not in scores:
            said = [
                "not tracked to the end"
                if s["joint_error"] is None
                else f"{1e3 * s['joint_error']:.3g} mrad"
                for s in scores
            ]
            lines.append(f"joint error {where}: {said[0]} untrained, {said[1]} trained")
    return lines


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())
