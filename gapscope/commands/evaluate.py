"""The command ``gapscope evaluate``: models, by how well an arm is tracked with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from gapscope.commands.options import Results, RobotOption, split_names
from gapscope.terminal import Progress, console, note, say, wrote

if TYPE_CHECKING:
    from gapscope.agents.models import AgentModel
    from gapscope.arm.nominal import NominalArm


def evaluate(
    ctx: typer.Context,
    models: Annotated[
        list[str],
        Argument(
            help="pd, gravity, nominal, a corrected.yaml, an identification.json, or the folder of a trained agent; "
            "each may be called NAME=...",
            metavar="MODEL...",
        ),
    ],
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: Annotated[
        Path | None,
        Option(
            help="what the arm that is tracked has beyond the nominal one, as corrected.yaml",
            metavar="FILE",
        ),
    ] = None,
    engine: Annotated[
        str | None,
        Option(help="pybullet or mujoco; both with a comma"),
    ] = None,
    motions: Annotated[
        str, Option(help="motions, with commas between them")
    ] = "fourier,pick,place,weld_seam",
    disturbances: Annotated[
        str, Option(help="none, push or noise; several with commas")
    ] = "none,push",
    seeds: Annotated[int, Option(min=1, help="how many of each motion")] = 3,
    duration: Annotated[float, Option(help="of each motion [s]")] = 4.0,
    bandwidth: Annotated[float, Option(help="of the control loop [Hz]")] = 4.0,
    damping: Annotated[float, Option(help="its damping ratio")] = 0.7,
    law: Annotated[
        str,
        Option(
            help="feedforward (the model beside PD), or computed (the model inside the loop)"
        ),
    ] = "feedforward",
    env: Annotated[
        str | None,
        Option(
            help="YAML file with robot, effects, engine, motions, bandwidth, ...; or gapscope/ArmTracking-v0. Options "
            "that are given win",
            metavar="FILE",
        ),
    ] = None,
    again: Annotated[
        bool,
        Option("--again", help="begin anew, also if an earlier run was interrupted"),
    ] = False,
) -> None:
    """Evaluate models and trained agents by how well an arm is tracked with them."""
    from gapscope.agents.controllers import Tuning
    from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
    from gapscope.agents.evaluation import evaluate as evaluate_models
    from gapscope.agents.models import read_models
    from gapscope.agents.summary import summarise
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.commands.evaluation_cells import Cells
    from gapscope.commands.inputs import read_arm
    from gapscope.commands.training_files import merge_options
    from gapscope.effects.corrected_file import error_context, read_corrected
    from gapscope.envs.engines import default_engine
    from gapscope.reports.evaluation import (
        DOCUMENT,
        evaluation_document,
        tables,
        write_evaluation,
    )

    chosen, options, unused = merge_options(env, ctx)
    if unused:
        note(f"note: {env}: ignored in an evaluation: {', '.join(unused)}")
    plan = EvaluationPlan(
        motions=split_names(options["motions"]),
        disturbances=split_names(options["disturbances"]),
        seeds=tuple(range(options["seeds"])),
        engines=split_names(options["engine"] or default_engine()),
        duration=options["duration"],
        tuning=Tuning(options["bandwidth"], options["damping"]),
        law=options["law"],
    )
    with Progress(chosen if isinstance(chosen, str) else chosen.name) as progress:
        arm = read_arm(chosen) if isinstance(chosen, str) else chosen
        source = options["effects"]
        hidden = () if source is None else read_corrected(source)
        tried = read_models(models, arm, _read_agent)
        with error_context(source, hidden):
            bench = TrackingBench(arm, hidden, plan)
        with locked(out):
            begin_results(out, DOCUMENT)
            # finished cells are kept until the results are whole: the same command goes on after an interruption
            with error_context(source, hidden):
                cells = Cells(out, bench, again)
                evaluation = evaluate_models(tried, bench, progress, cells)
            if cells.reused:
                progress(
                    f"{cells.reused} parts were taken from a run that was interrupted"
                )
            lines = summarise(evaluation)
            content = evaluation_document(bench, evaluation, lines)
            progress("writes the page")
            paths = write_evaluation(content, lines, out)
            cells.clear()
    console.print(tables(lines, content))
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        say(f"rank correlation of torque error and joint error: {correlation:.2f}")
    wrote(*paths)


def _read_agent(folder: Path, arm: NominalArm) -> AgentModel:
    """The agent of a folder; torch is imported here, so that models do without it."""
    from gapscope.agents.training.policy import read_agent_model

    return read_agent_model(folder, arm)
