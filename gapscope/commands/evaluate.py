"""The command ``gapscope evaluate``: models, by how well an arm is tracked with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from gapscope.commands.options import File, Positive, Results, RobotOption, split_names
from gapscope.terminal import Progress, console, note, say, wrote

if TYPE_CHECKING:
    from gapscope.agents.models import AgentModel
    from gapscope.arm.nominal import NominalArm


def evaluate(
    ctx: typer.Context,
    models: Annotated[list[str], Argument(metavar="MODEL...")],
    *,
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: File | None = None,
    engine: str | None = None,
    motions: str = "fourier,pick,place,weld_seam",
    disturbances: str = "none,push",
    seeds: Positive = 3,
    duration: float = 4.0,
    bandwidth: float = 4.0,
    damping: float = 0.7,
    law: str = "feedforward",
    env: Annotated[str | None, Option(metavar="FILE")] = None,
    again: bool = False,
) -> None:
    """Evaluate models and trained agents by how well an arm is tracked with them.

    Args:
        models: pd, gravity, nominal, a corrected.yaml, an identification.json, or the folder of a trained agent; each
            may be called NAME=...
        effects: what the arm that is tracked has beyond the nominal one, as corrected.yaml
        engine: pybullet or mujoco; both with a comma
        motions: motions, with commas between them
        disturbances: none, push or noise; several with commas
        seeds: how many of each motion
        duration: of each motion [s]
        bandwidth: of the control loop [Hz]
        damping: its damping ratio
        law: feedforward (the model beside PD), or computed (the model inside the loop)
        env: YAML file with robot, effects, engine, motions, bandwidth, ...; or gapscope/ArmTracking-v0. Options that
            are given win
        again: begin anew, also if an earlier run was interrupted
    """
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
