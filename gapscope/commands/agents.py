"""The commands for models and agents: ``identify``, ``residual``, ``matter``, ``train``, ``evaluate``."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from gapscope.commands.options import (
    AsJson,
    CasePath,
    Engine,
    File,
    Folder,
    Model,
    Names,
    NotNegative,
    Positive,
    Results,
    RobotOption,
    split_names,
)
from gapscope.terminal import Progress, console, note, say, show, wrote

if TYPE_CHECKING:
    from gapscope.agents.models import AgentModel
    from gapscope.arm.nominal import NominalArm


def identify(
    case: CasePath,
    *,
    out: Results,
    cutoff: Annotated[float | None, Option(min=0.1)] = None,
    estimator: str = "consistent",
    judge: Names = None,
    any_torque: bool = False,
    filter_: str = "recursive",
    ridge: Annotated[float | None, Option(min=0.0)] = None,
    singular_values: NotNegative | None = None,
    keep: Annotated[str, Option(metavar="NAMES")] = "",
) -> None:
    """Identify base and physical parameters and friction.

    Args:
        cutoff: cut-off of both sides [Hz]; default: from the spectra of the positions
        estimator: consistent, wls, ols, irls, ridge, l_curve, truncated_svd, total_least_squares, maximum_likelihood,
            kalman, partial_update, log_cholesky, sdp_euclidean or sdp_entropic; or, by simulation of the closed loop,
            instrumental_variables, didim or output_error
        judge: name of a recording to hold out for validation; default: the case's, or the last
        any_torque: go on if the torque shows that the case reads its log wrongly, or says another gravity
        filter_: recursive, over base parameters; or unscented: states and friction together as well, from encoders and
            torque without differentiating (about a second for each second of the first recording)
        ridge: strength of the pull to the nominal arm, with columns of unit norm; default: by held-out motions
        singular_values: directions that truncated_svd keeps; default: by held-out motions
        keep: parameters that stay at the nominal arm's, with commas: m5, I3, or link5 for all of a link
    """
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.ident.identification import IdentificationSettings
    from gapscope.interface.identify import identify as identify_case
    from gapscope.reports.identification import DOCUMENT

    # a strength without an estimator asks for the one that has it
    if estimator == "consistent" and ridge is not None:
        estimator = "ridge"
    if estimator == "consistent" and singular_values is not None:
        estimator = "truncated_svd"
    settings = IdentificationSettings(
        cutoff,
        estimator,
        tuple(judge or ()),
        any_torque,
        filter=filter_,
        ridge=ridge,
        singular_values=singular_values,
        keep=split_names(keep),
    )
    with Progress(case) as progress, locked(out):
        # the document of an earlier run goes: one that is there is of this run
        begin_results(out, DOCUMENT)
        result = identify_case(case, settings, progress=progress)
        progress("writes the report")
        paths = result.save(out)
    show(result, *paths)


def residual(
    case: CasePath,
    *,
    out: Results,
    model: Model = None,
    form: str = "best",
    apart: str = "best",
    judge: Names = None,
    onnx: bool = False,
    seed: NotNegative = 0,
) -> None:
    """Train a network on what the effects leave, and judge it on recordings set aside (extra: learn).

    Args:
        form: best (chosen per joint on held-out recordings), additive, mlp or tcn
        apart: what the network must not explain: effects; all (inertial parameters, friction, rotors, offsets too); or
            best (effects alone if that closes more of held-out recordings)
        judge: name of a recording to set aside; default: the case's, or the last
        onnx: write residual.onnx as well
        seed: of weights and batches
    """
    from gapscope.arm.errors import extra

    # asked before any work: training takes minutes
    with extra("learn", "training a residual network"):
        for name in ("torch", "sklearn", *(("onnx",) if onnx else ())):
            import_module(name)
    from gapscope.arm.case import load_case
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.ident.residual.fit import ResidualSettings, learn_residual
    from gapscope.interface.models import corrected_arm
    from gapscope.reports.residual import DOCUMENT, summary, write_learnt

    settings = ResidualSettings(form=form, apart=apart, seed=seed)
    with Progress(case) as progress, locked(out):
        begin_results(out, DOCUMENT)
        progress("reads")
        loaded = load_case(case)
        corrected = corrected_arm(loaded.arm, model)
        found = learn_residual(loaded, corrected, settings, judge or (), progress)
        content, paths = write_learnt(found, out, onnx=onnx, progress=progress)
    console.print(summary(content))
    wrote(*paths)


def matter(
    case: CasePath,
    *,
    task: File,
    model: Model = None,
    diagnosis: Folder | None = None,
    out: Folder | None = None,
    seeds: Positive = 5,
    action: str = "residual",
    motions: str = "fourier",
    engine: Engine = None,
    jobs: Positive = 1,
    json_: AsJson = False,
) -> None:
    """Rank the effects found by what they do to a task of yours: each switched on alone, and off alone.

    Args:
        task: a trajectory (t, q1..) or a recording (its q_ref1..), a policy as .onnx, or an agent's folder
        diagnosis: folder of a diagnosis in place of --model: values are drawn within its intervals
        out: folder for matter.html and matter.json
        seeds: of a policy's motions, and of the values drawn
        action: kind of actions of an .onnx: torque, residual, scale or gains
        motions: that a policy tracks, with commas between them
        jobs: simulations at a time
    """
    from gapscope.many.matter import matter as rank

    with Progress(case) as progress:
        result = rank(
            case,
            task,
            model=model,
            diagnosis=diagnosis,
            seeds=seeds,
            action=action,
            motions=split_names(motions),
            engine=engine,
            jobs=jobs,
            progress=progress,
        )
        written = () if out is None else result.save(out)
    show(result, *written, as_json=json_)


def train(
    model: str,
    *,
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: File | None = None,
    agent: Annotated[str | None, Option(metavar="NAME|FILE")] = None,
    steps: int | None = None,
    seed: NotNegative | None = None,
    engine: str | None = None,
    parallel: bool = False,
    randomise: bool = False,
    tune: Annotated[int, Option(metavar="TRIALS", min=0)] = 0,
    again: bool = False,
) -> None:
    """Train an agent on top of a model's feedforward.

    It learns in the simulator made from that model, and is tried on an arm with hidden effects.

    Args:
        model: pd, gravity, nominal, a corrected.yaml, or an identification.json
        effects: hidden effects of the arm that the agent is tried on, as corrected.yaml; training never sees them
        agent: ppo, ppo_residual, sac, td3, or a YAML file with settings; default: ppo, on pd and gravity ppo_residual
        steps: actions to train for; default: the settings'
        seed: of weights, motions and exploration
        engine: mujoco (default: all environments together) or pybullet
        parallel: step each environment in a process of its own
        randomise: draw any effects around the model in every episode, not only what its diagnosis leaves open
        tune: search hyperparameters in so many short trainings instead
        again: replace what the folder holds of an earlier training
    """
    from gapscope.agents.training.task import ROUGH, Task
    from gapscope.agents.training.training_loop import check_installed
    from gapscope.agents.training.training_loop import tune as search
    from gapscope.agents.training.training_settings import RESIDUAL, read_settings
    from gapscope.arm.io.locked_section import locked
    from gapscope.commands.agent_files import claim, trained_in
    from gapscope.effects.corrected_file import error_context, read_corrected
    from gapscope.interface.models import make_arm

    # a rough model lacks torque, which an agent adds; to others it sets the gains
    agent = agent or (RESIDUAL if model in ROUGH else "ppo")
    settings = read_settings(
        agent, steps=steps, seed=seed, engine=engine, parallel=parallel or None
    )
    if randomise:
        settings = settings.randomised()
    check_installed()
    content: dict[str, Any] = {}
    with Progress(model) as progress:
        hidden = None if effects is None else read_corrected(effects)
        task = Task.of(model, make_arm(robot), hidden)
        settings = task.settled(settings)
        task.check(settings)
        # the hidden arm is made once before: an effect that it cannot have ends it here
        with error_context(effects, hidden or ()):
            task.trials(settings, 1, hidden=True).close()
        with locked(out):
            claim(out, task, settings, tune, again=again)
            if tune:
                paths = [search(task, settings, tune, out, progress)]
            else:
                content, paths = trained_in(out, task, settings, progress)
    if content:
        # which agent is kept and why, and the joint errors before and after, in the simulator and on the hidden
        # arm
        places = {
            "simulator": "in the simulator made from the model",
            "hidden": "on the hidden arm",
        }
        lines = [content["reason"], "the agent after the last round is in last/"]
        for key, place in places.items():
            states = {
                name: content[name][key] for name in ("untrained", "kept", "last")
            }
            # an agent that was not tried there has no score
            if all(states.values()):
                texts = [
                    f"{_joint_error(score)} {name}" for name, score in states.items()
                ]
                lines.append(f"joint error {place}: {', '.join(texts)}")
        say(*lines)
    wrote(*paths)


def _joint_error(score: dict[str, Any]) -> str:
    error = score["joint_error"]
    return "not tracked to the end" if error is None else f"{1e3 * error:.3g} mrad"


def _from_file(ctx: typer.Context, source: str | None) -> str | None:
    """What an environment says becomes the defaults of the options beside it."""
    if source is not None:
        from gapscope.commands.agent_files import read_environment

        ctx.default_map = read_environment(source)
    return source


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
    env: Annotated[
        str | None, Option(metavar="FILE", callback=_from_file, is_eager=True)
    ] = None,
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
    from gapscope.agents.evaluation import EvaluationPlan, TrackingBench, summarise
    from gapscope.agents.evaluation import evaluate as evaluate_models
    from gapscope.agents.models import read_models
    from gapscope.agents.tracking import Tuning
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.robots import load_nominal_arm
    from gapscope.commands.agent_files import UNUSED, Cells
    from gapscope.effects.corrected_file import error_context, read_corrected
    from gapscope.envs.engines import default_engine
    from gapscope.interface.models import make_arm
    from gapscope.reports.evaluation import (
        DOCUMENT,
        evaluation_document,
        tables,
        write_evaluation,
    )

    said = ctx.default_map or {}
    if unused := [key for key in said if key in UNUSED]:
        note(f"note: {env}: ignored in an evaluation: {', '.join(unused)}")
    plan = EvaluationPlan(
        motions=split_names(motions),
        disturbances=split_names(disturbances),
        seeds=tuple(range(seeds)),
        engines=split_names(engine or default_engine()),
        duration=duration,
        tuning=Tuning(bandwidth, damping),
        law=law,
    )
    # the data sheet of a file is that of its robot
    typed = str(ctx.get_parameter_source("robot")).endswith("COMMANDLINE")
    with Progress(robot) as progress:
        if "sheet" in said and not typed:
            source = Path(str(env))
            arm = load_nominal_arm(robot, sheet=said["sheet"], source=source)
        else:
            arm = make_arm(robot)
        hidden = () if effects is None else read_corrected(effects)
        tried = read_models(models, arm, _read_agent)
        with error_context(effects, hidden):
            bench = TrackingBench(arm, hidden, plan)
        with locked(out):
            begin_results(out, DOCUMENT)
            # finished cells are kept until the results are whole: the same command goes on after an interruption
            with error_context(effects, hidden):
                cells = Cells(out, bench, again)
                episodes, margins = evaluate_models(tried, bench, progress, cells)
            if cells.reused:
                progress(
                    f"{cells.reused} parts were taken from a run that was interrupted"
                )
            lines = summarise(episodes, margins)
            content = evaluation_document(bench, episodes, lines)
            progress("writes the page")
            paths = write_evaluation(content, lines, out)
            # the results are whole: what was kept for going on goes
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
