"""The command ``gapscope evaluate``: models, by how well an arm is tracked with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gapscope.commands.options import Results, RobotOption, split_names
from gapscope.terminal import Progress, console, note, say, wrote

if TYPE_CHECKING:
    from gapscope.agents.evaluation import EvaluationPlan
    from gapscope.agents.models import AgentModel
    from gapscope.agents.summary import SummaryLine
    from gapscope.arm.nominal import NominalArm

Models = Annotated[
    list[str],
    typer.Argument(
        help="pd, gravity, nominal, a corrected.yaml, an identification.json, or the folder of a trained agent; each "
        "may be called NAME=...",
        metavar="MODEL...",
    ),
]
HiddenEffects = Annotated[
    Path | None,
    typer.Option(
        help="what the arm that is tracked has beyond the nominal one, as corrected.yaml",
        metavar="FILE",
    ),
]
Engines = Annotated[
    str | None,
    typer.Option(help="pybullet or mujoco; both with a comma"),
]
Motions = Annotated[str, typer.Option(help="motions, with commas between them")]
Disturbances = Annotated[
    str, typer.Option(help="none, push or noise; several with commas")
]
Seeds = Annotated[int, typer.Option(min=1, help="how many of each motion")]
Duration = Annotated[float, typer.Option(help="of each motion [s]")]
Bandwidth = Annotated[float, typer.Option(help="of the control loop [Hz]")]
Damping = Annotated[float, typer.Option(help="its damping ratio")]
Law = Annotated[
    str,
    typer.Option(
        help="feedforward (the model beside PD), or computed (the model inside the loop)"
    ),
]
Environment = Annotated[
    str | None,
    typer.Option(
        help="YAML file with robot, effects, engine, motions, bandwidth, ...; or gapscope/ArmTracking-v0. Options "
        "that are given win",
        metavar="FILE",
    ),
]
Again = Annotated[
    bool,
    typer.Option("--again", help="begin anew, also if an earlier run was interrupted"),
]


def evaluate(
    ctx: typer.Context,
    models: Models,
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: HiddenEffects = None,
    engine: Engines = None,
    motions: Motions = "fourier,pick,place,weld_seam",
    disturbances: Disturbances = "none,push",
    seeds: Seeds = 3,
    duration: Duration = 4.0,
    bandwidth: Bandwidth = 4.0,
    damping: Damping = 0.7,
    law: Law = "feedforward",
    env: Environment = None,
    again: Again = False,
) -> None:
    """Evaluate models and trained agents by how well an arm is tracked with them."""
    from gapscope.commands.training_files import merge_options
    from gapscope.reports.evaluation import tables

    arm, options, unused = merge_options(env, ctx)
    if unused:
        note(f"note: {env}: ignored in an evaluation: {', '.join(unused)}")
    plan = _plan(options)
    with Progress(arm if isinstance(arm, str) else arm.name) as progress:
        content, lines, paths = evaluate_path(
            models, arm, options["effects"], plan, out, progress, again=again
        )
    console.print(tables(lines, content))
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        say(f"rank correlation of torque error and joint error: {correlation:.2f}")
    wrote(*paths)


def _plan(options: dict[str, Any]) -> EvaluationPlan:
    from gapscope.agents.controllers import Tuning
    from gapscope.agents.evaluation import EvaluationPlan
    from gapscope.envs.engines import default_engine

    return EvaluationPlan(
        motions=split_names(options["motions"]),
        disturbances=split_names(options["disturbances"]),
        seeds=tuple(range(options["seeds"])),
        engines=split_names(options["engine"] or default_engine()),
        duration=options["duration"],
        tuning=Tuning(options["bandwidth"], options["damping"]),
        law=options["law"],
    )


def _read_agent(folder: Path, arm: NominalArm) -> AgentModel:
    """The agent of a folder; torch is imported here, so that models do without it."""
    from gapscope.agents.training.policy import read_agent_model

    return read_agent_model(folder, arm)


def evaluate_path(
    models: list[str],
    robot: str | NominalArm,
    effects: Path | None,
    plan: EvaluationPlan,
    out: Path,
    progress: Callable[[str], None] = lambda message: None,
    *,
    again: bool = False,
) -> tuple[dict[str, Any], list[SummaryLine], list[Path]]:
    """Evaluate models and write the results; see ``gapscope.reports.evaluation``.

    Finished cells are kept in a folder in ``out`` until then, so that the same call continues after an interruption.

    Args:
        models: see ``gapscope.agents.models.read_models``.
        robot: a nominal arm; a name or URDF; or a case, whose nominal arm is taken.
        effects: file of the form of ``corrected.yaml`` with what the arm that is tracked has beyond the nominal one.
        plan: how to evaluate.
        out: folder for the results.
        progress: called with a few words at each step.
        again: ignore what an earlier call has kept.

    Returns:
        The document, its lines, and the files.

    Raises:
        InputError: an argument or a file is at fault.
        GapscopeError: a file cannot be written.
    """
    from gapscope.agents.evaluation import TrackingBench
    from gapscope.agents.evaluation import evaluate as evaluate_models
    from gapscope.agents.models import read_models
    from gapscope.agents.summary import summarise
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.commands.evaluation_cells import Cells
    from gapscope.commands.inputs import read_arm
    from gapscope.effects.corrected_file import error_context, read_corrected
    from gapscope.reports.evaluation import (
        DOCUMENT,
        evaluation_document,
        write_evaluation,
    )

    arm = read_arm(robot) if isinstance(robot, str) else robot
    hidden = () if effects is None else read_corrected(effects)
    tried = read_models(models, arm, _read_agent)
    with error_context(effects, hidden):
        bench = TrackingBench(arm, hidden, plan)
    with locked(out):
        begin_results(out, DOCUMENT)
        with error_context(effects, hidden):
            cells = Cells(out, bench, again)
            evaluation = evaluate_models(tried, bench, progress, cells)
        if cells.reused:
            progress(f"{cells.reused} parts were taken from a run that was interrupted")
        lines = summarise(evaluation)
        content = evaluation_document(bench, evaluation, lines)
        progress("writes the page")
        paths = write_evaluation(content, lines, out)
        cells.clear()
    return content, lines, paths
