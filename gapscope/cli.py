"""The command line: ``gapscope COMMAND``; commands import what they need when they run."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console

from arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.blind import blind

if TYPE_CHECKING:
    from rich.status import Status

app = typer.Typer(
    help="Finds out why a simulated robot arm and a real one disagree.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # markup would swallow the units, [m]
    pretty_exceptions_enable=False,
)
app.add_typer(blind, name="blind")
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
_console = Console()
_log = Console(stderr=True)
_python_warning = warnings.showwarning

CasePath = Annotated[Path, typer.Argument(help="folder of the case, or its case file", metavar="CASE")]
Model = Annotated[Optional[Path], typer.Option(help="corrected.yaml of a diagnosis; default: the nominal arm")]  # noqa: UP045


class _Progress:
    """What is being done: a spinner on a terminal, a line each elsewhere; on standard error."""

    def __init__(self, label: str) -> None:
        self.label = label
        self._status: Status | None = _log.status(label) if _log.is_terminal else None

    def __enter__(self) -> _Progress:
        if self._status:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status:
            self._status.stop()

    def __call__(self, message: str) -> None:
        text = f"{self.label}: {message}"
        if self._status:
            self._status.update(text)
        else:
            _log.print(text, highlight=False)


@app.command()
def diagnose(
    cases: Annotated[list[Path], typer.Argument(help="folders of cases, or case files", metavar="CASE...")],
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")],
    jobs: Annotated[int, typer.Option(min=1, help="cases at a time, where there are several")] = 1,
    backend: Annotated[str, typer.Option(help="local, or ray (a cluster; needs ray installed)")] = "local",
    again: Annotated[
        bool, typer.Option("--again", help="of several cases, diagnose also those that an earlier run has finished")
    ] = False,
    against: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="case of the same arm, known healthy and without load: what changed?", metavar="REFERENCE"),
    ] = None,
) -> None:
    """Find where the gap lies, what causes it, and how far it closes."""
    if against is not None:
        _diagnose_against(cases, against, out)
        return
    if len(cases) == 1:
        from diagnosis.terminal import print_summary
        from gapscope.run import diagnose_path

        with _Progress(cases[0].name or str(cases[0])) as progress:
            result = diagnose_path(cases[0], out, progress)
        print_summary(result.document, _console)
        _wrote(out / "report.html", out / "diagnosis.json", out / "corrected.yaml")
        return
    from gapscope.batch import SUMMARY, UNITS, Batch, diagnose_all

    with _Progress(f"{len(cases)} cases") as progress:
        code = diagnose_all(Batch(tuple(cases), out, jobs, backend, again), progress, _console)
    _wrote(*(out / name for name in (SUMMARY, UNITS) if (out / name).is_file()))
    raise typer.Exit(code)


def _diagnose_against(cases: list[Path], reference: Path, out: Path) -> None:
    from diagnosis.terminal import print_summary
    from gapscope.against import CASE, URDF, diagnose_against

    if len(cases) > 1:
        raise InputError("takes one case at a time", "run the command once for each case", where="--against")
    with _Progress(cases[0].name or str(cases[0])) as progress:
        change = diagnose_against(cases[0], reference, out, progress)
    print_summary(change.diagnosis.document, _console)
    _wrote(*(out / name for name in ("report.html", "diagnosis.json", "corrected.yaml", CASE, URDF)))
    _console.print(
        f"to predict with what was found: gapscope predict {out / CASE} --model {out / 'corrected.yaml'} ...",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip


@app.command()
def predict(
    case: CasePath,
    recording: Annotated[Path, typer.Option(help="recording with t, q1..; other columns are not used", metavar="FILE")],
    out: Annotated[Path, typer.Option(help="CSV to write: t, tau1..", metavar="FILE.csv")],
    model: Model = None,
) -> None:
    """Predict the torque that a model says would be recorded."""
    from arm.writing import write_columns
    from diagnosis.predict import predict_torque
    from gapscope.run import corrected_arm, load_for_prediction

    with _Progress(recording.name) as progress:
        progress("reads")
        arm, motion = load_for_prediction(case, recording)
        progress("predicts")
        torque = predict_torque(corrected_arm(arm, model), motion)
        write_columns({"t": motion.t, **{f"tau{j + 1}": torque[:, j] for j in range(arm.n_joints)}}, out)
    _wrote(out)


@app.command()
def replay(
    case: CasePath,
    recording: Annotated[Path, typer.Option(help="recording with q_ref1.., or tau1.. without", metavar="FILE")],
    out: Annotated[Path, typer.Option(help="CSV to write: t, q1.., tau1..", metavar="FILE.csv")],
    model: Model = None,
    engine: Annotated[str, typer.Option(help="pybullet, mujoco or dart")] = "pybullet",
) -> None:
    """Move the simulated arm under the same commands as a recording."""
    from arm.writing import write_columns
    from gapscope.run import replay_file
    from gapscope.show import replay_line

    with _Progress(recording.name) as progress:
        replayed = replay_file(case, recording, model, engine, progress)
        columns = {f"{name}{j + 1}": x for name in ("q", "tau") for j, x in enumerate(getattr(replayed, name).T)}
        write_columns({"t": replayed.t, **columns}, out)
    _console.print(replay_line(replayed), highlight=False, soft_wrap=True)
    _wrote(out)


@app.command()
def gap(
    case: CasePath,
    model: Model = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON to standard output")] = False,
) -> None:
    """Measure the gap alone, per joint, of a nominal or corrected arm."""
    from arm.case import load_case
    from gapscope.run import corrected_arm
    from gapscope.show import gap_document, gap_tables

    with _Progress(case.name or str(case)) as progress:
        progress("measures the gap")
        loaded = load_case(case)
        measured = gap_document(loaded, corrected_arm(loaded.arm, model))
    if as_json:
        sys.stdout.write(json.dumps(measured, indent=2, allow_nan=False) + "\n")
    else:
        _console.print(gap_tables(measured, loaded.arm.joints))


@app.command()
def identify(
    case: CasePath,
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")],
    cutoff: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(min=0.1, help="cut-off of both sides [Hz]; default: from the spectra of the positions"),
    ] = None,
    estimator: Annotated[
        str,
        typer.Option(
            help="consistent, wls, ols, irls, ridge, truncated_svd, total_least_squares, maximum_likelihood, "
            "partial_update, log_cholesky, sdp_euclidean or sdp_entropic"
        ),
    ] = "consistent",
    judge: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(help="name of a recording to judge on; default: the case's, or the last", metavar="NAME"),
    ] = None,
    any_torque: Annotated[
        bool, typer.Option("--any-torque", help="go on where the torque seems not to be in N m")
    ] = False,
) -> None:
    """Identify base and physical parameters and friction."""
    from gapscope.identify import identify_path, summary
    from ident.identification import Settings

    settings = Settings(cutoff, estimator, tuple(judge or ()), any_torque)
    with _Progress(case.name or str(case)) as progress:
        identified = identify_path(case, out, settings, progress)
    _console.print(summary(identified))
    _wrote(*identified.paths)


@app.command()
def record(
    robot: Annotated[str, typer.Argument(help="kuka_iiwa, ..., a URDF, or a case with a data sheet", metavar="ROBOT")],
    effects: Annotated[Path, typer.Option(help="effects, in the form of corrected.yaml", metavar="FILE")],
    out: Annotated[Path, typer.Option(help="folder of the case to make", metavar="CASE")],
    trajectory: Annotated[
        str, typer.Option(help="fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote")
    ] = "fourier",
    recordings: Annotated[int, typer.Option(help="how many, from slow to fast")] = 4,
    duration: Annotated[float, typer.Option(help="of each [s]")] = 10.0,
    rate: Annotated[float, typer.Option(help="samples per second [Hz]")] = 250.0,
    controller: Annotated[
        str,
        typer.Option(
            help="pd (as the case ROBOT has it, else with nominal feedforward), or a YAML file in the form of the "
            "controller: section of a case",
            metavar="KIND|FILE",
        ),
    ] = "pd",
    read_back: Annotated[
        bool,
        typer.Option(
            "--read-back",
            help="record the torque that reached the joints, read back from the drives, in place of "
            "the torque commanded",
        ),
    ] = False,
    noise: Annotated[float, typer.Option(help="noise of the torque, as a share of its standard deviation")] = 0.01,
    encoder_noise: Annotated[float, typer.Option(help="noise of the encoders [rad]")] = 0.0,
    file_format: Annotated[str, typer.Option("--format", help="csv, parquet or npz")] = "csv",
    engine: Annotated[str, typer.Option(help="pybullet, mujoco or dart")] = "pybullet",
    seed: Annotated[Optional[int], typer.Option(min=0, help="draw the same motions and noise again")] = None,  # noqa: UP045
    sealed: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="folder for the truth, outside the case", metavar="DIR"),
    ] = None,
) -> None:
    """Record a simulated arm with effects as a case.

    The truth is kept in truth.yaml, in the case or sealed elsewhere.
    """
    from envs.session import Plan
    from gapscope.recording import record_files

    plan = Plan(trajectory, recordings, duration, rate, read_back, noise, encoder_noise, engine)
    with _Progress(out.name or str(out)) as progress:
        paths, note = record_files(
            robot, effects, out, plan, controller=controller, seed=seed, ending=file_format, sealed=sealed,
            progress=progress,
        )  # fmt: skip
    if note:
        _log.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    _wrote(*paths)


@app.command()
def excite(
    robot: Annotated[str, typer.Argument(help="kuka_iiwa, ..., a URDF, or a case with a data sheet", metavar="ROBOT")],
    out: Annotated[Path, typer.Option(help="CSV to write; .yaml for ROS and .html with plots beside", metavar="FILE")],
    kind: Annotated[str, typer.Option(help="fourier, quintic (through way points) or multisine")] = "fourier",
    order: Annotated[int, typer.Option(help="number of harmonics; half that of way points")] = 5,
    frequency: Annotated[float, typer.Option(help="of the first harmonic [Hz]")] = 0.1,
    duration: Annotated[Optional[float], typer.Option(help="length [s]; by default 10, or one period")] = None,  # noqa: UP045
    rate: Annotated[float, typer.Option(help="samples per second that are written [Hz]")] = 250.0,
    criterion: Annotated[str, typer.Option(help="condition, d, e or separation (of --effects)")] = "condition",
    effects: Annotated[str, typer.Option(help="effects to tell apart, with commas between them")] = "",
    optimiser: Annotated[Optional[str], typer.Option(help="random, swarm, cma or gradient")] = None,  # noqa: UP045
    evaluations: Annotated[int, typer.Option(help="candidates to judge; 8 for one with its gradient")] = 3000,
    seconds: Annotated[Optional[float], typer.Option(help="time to search, at most [s]")] = None,  # noqa: UP045
    velocity: Annotated[float, typer.Option(help="no joint moves faster [rad/s]")] = 1.5,
    acceleration: Annotated[float, typer.Option(help="limit of every joint [rad/s^2]")] = 5.0,
    torque: Annotated[float, typer.Option(help="share of the torque limits that may be used [1]")] = 0.8,
    margin: Annotated[float, typer.Option(help="distance from the position limits [rad]")] = 0.1,
    singular: Annotated[float, typer.Option(help="least singular value of the Jacobian [m/rad, 1]; 0 for any")] = 0.02,
    clearance: Annotated[float, typer.Option(help="least distance between bodies and to the surface [m]")] = 0.01,
    surface: Annotated[float, typer.Option(help="height of the surface under the arm, base frame [m]")] = 0.0,
    collisions: Annotated[bool, typer.Option(help="check collisions with the meshes of the URDF")] = True,
    seed: Annotated[Optional[int], typer.Option(min=0, help="find the same trajectory again")] = None,  # noqa: UP045
) -> None:
    """Design an exciting trajectory within limits.

    It is written as CSV, as a ROS JointTrajectory, and as a page of plots.
    """
    from gapscope.excite import SearchProgress, excite_files, margin_lines, margin_table, summary
    from ident.excitation.plan import LimitPlan, Plan
    from ident.excitation.search import Budget

    names = tuple(name.strip() for name in effects.split(",") if name.strip())
    plan = Plan(
        kind, order, frequency, duration, rate, criterion, names, optimiser=optimiser,
        budget=Budget(evaluations, seconds),
    )  # fmt: skip
    limits = LimitPlan(velocity, acceleration, torque, margin, singular, clearance, surface, collisions)
    with SearchProgress(robot, criterion, _log) as progress:
        found, paths = excite_files(robot, out, plan, limits, seed=seed, progress=progress)
    _console.print(margin_table(found))
    for line in (*margin_lines(found), *summary(found, plan)):
        _console.print(line, highlight=False, markup=False, soft_wrap=True)
    _wrote(*paths)


@app.command()
def advise(
    case: CasePath,
    out: Annotated[Path, typer.Option(help="CSV to write; .yaml for ROS and .html with plots beside", metavar="FILE")],
    diagnosis: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="folder that diagnose wrote for this case; default: diagnose it now", metavar="DIR"),
    ] = None,
    payload: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(help="mass of a known body that could be mounted; used where it separates better [kg]"),
    ] = None,
    payload_com: Annotated[
        str, typer.Option(help="its centre in the frame of the joint that moves the last link, x,y,z [m]")
    ] = "0,0,0",
    fastest: Annotated[float, typer.Option(help="highest frequency that the controller follows [Hz]")] = 5.0,
    rate: Annotated[float, typer.Option(help="samples per second [Hz]")] = 250.0,
    evaluations: Annotated[int, typer.Option(min=1, help="candidates to judge, over all speeds and loads")] = 1000,
    velocity: Annotated[float, typer.Option(help="no joint moves faster [rad/s]")] = 1.5,
    acceleration: Annotated[float, typer.Option(help="limit of every joint [rad/s^2]")] = 5.0,
    torque: Annotated[float, typer.Option(help="share of the torque limits that may be used")] = 0.8,
    margin: Annotated[float, typer.Option(help="distance from the position limits [rad]")] = 0.1,
    singular: Annotated[float, typer.Option(help="least singular value of the tool's Jacobian; 0 for any")] = 0.02,
    clearance: Annotated[float, typer.Option(help="least distance between bodies and to the surface [m]")] = 0.01,
    surface: Annotated[float, typer.Option(help="height of the surface under the arm in the base frame [m]")] = 0.0,
    collisions: Annotated[bool, typer.Option(help="check collisions with the meshes of the URDF")] = True,
    seed: Annotated[Optional[int], typer.Option(min=0, help="find the same trajectory again")] = None,  # noqa: UP045
) -> None:
    """Design the recording that separates what is still confounded."""
    from diagnosis.advice.advise import Request
    from diagnosis.advice.wording import lines
    from gapscope.advise import check_out, findings, payload_of, write_advice
    from gapscope.excite import SearchProgress, margin_lines, margin_table
    from ident.excitation.plan import LimitPlan

    check_out(out)
    limits = LimitPlan(velocity, acceleration, torque, margin, singular, clearance, surface, collisions)
    request = Request(limits, payload_of(payload, payload_com), fastest, rate, evaluations, seed)
    label = case.name or str(case)
    with _Progress(label) as progress:
        loaded, found = findings(case, diagnosis, progress)
    with SearchProgress(label, "separation", _log) as search:
        advice, paths = write_advice(loaded, found, request, out, search)
    if advice.excitation is not None:
        _console.print(margin_table(advice.excitation))
        for line in margin_lines(advice.excitation):
            _console.print(line, highlight=False, markup=False, soft_wrap=True)
    for line in lines(advice, found[0]):
        _console.print(line, highlight=False, markup=False, soft_wrap=True)
    _wrote(*paths)


@app.command()
def evaluate(
    ctx: typer.Context,
    models: Annotated[
        list[str],
        typer.Argument(
            help="pd, gravity, nominal, a corrected.yaml, or an identification.json; each may be called NAME=...",
            metavar="MODEL...",
        ),
    ],
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")],
    robot: Annotated[
        str, typer.Option(help="kuka_iiwa, ..., a URDF, or a case with a data sheet", metavar="ROBOT")
    ] = "kuka_iiwa",
    effects: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="what the arm that is tracked has beyond the nominal one, as corrected.yaml", metavar="FILE"),
    ] = None,
    engine: Annotated[str, typer.Option(help="pybullet, mujoco or dart; several with commas")] = "pybullet",
    motions: Annotated[str, typer.Option(help="motions, with commas between them")] = "fourier,pick,place,weld_seam",
    disturbances: Annotated[str, typer.Option(help="none, push or noise; several with commas")] = "none,push",
    seeds: Annotated[int, typer.Option(min=1, help="how many of each motion")] = 3,
    duration: Annotated[float, typer.Option(help="of each motion [s]")] = 4.0,
    bandwidth: Annotated[float, typer.Option(help="of the control loop [Hz]")] = 4.0,
    damping: Annotated[float, typer.Option(help="its damping ratio")] = 0.7,
    law: Annotated[
        str, typer.Option(help="feedforward (the model beside PD), or computed (the model inside the loop)")
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
        bool, typer.Option("--again", help="begin anew, also where an earlier run was interrupted")
    ] = False,
) -> None:
    """Evaluate models by how well an arm is tracked with them."""
    from agents.evaluation import Plan
    from agents.gains import Tuning
    from gapscope.environment_file import chosen
    from gapscope.evaluate import evaluate_files
    from gapscope.evaluation_table import tables

    arm, given, unused = chosen(env, ctx)
    if unused:
        _log.print(f"note: {env}: {', '.join(unused)} have no say here", highlight=False, markup=False, soft_wrap=True)
    plan = Plan(
        _names(given["motions"]), _names(given["disturbances"]), tuple(range(given["seeds"])), _names(given["engine"]),
        given["duration"], Tuning(given["bandwidth"], given["damping"]), given["law"],
    )  # fmt: skip
    with _Progress(arm if isinstance(arm, str) else arm.name) as progress:
        content, lines, paths = evaluate_files(models, arm, given["effects"], plan, out, progress, again=again)
    _console.print(tables(lines, content))
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        _console.print(f"rank correlation of torque error and joint error: {correlation:.2f}", highlight=False)
    _wrote(*paths)


@app.command()
def train(
    model: Annotated[
        str,
        typer.Argument(help="pd, gravity, nominal, a corrected.yaml, or an identification.json", metavar="MODEL"),
    ],
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")],
    robot: Annotated[
        str, typer.Option(help="kuka_iiwa, ..., a URDF, or a case with a data sheet", metavar="ROBOT")
    ] = "kuka_iiwa",
    effects: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="hidden effects of the arm that the agent is tried on, as corrected.yaml; training never sees them",
            metavar="FILE",
        ),
    ] = None,
    agent: Annotated[
        str, typer.Option(help="ppo, sac, td3, or a YAML file with settings", metavar="NAME|FILE")
    ] = "ppo",
    steps: Annotated[Optional[int], typer.Option(help="actions to train for; default: the settings'")] = None,  # noqa: UP045
    seed: Annotated[Optional[int], typer.Option(min=0, help="of weights, motions and exploration")] = None,  # noqa: UP045
    engine: Annotated[Optional[str], typer.Option(help="pybullet, mujoco or dart")] = None,  # noqa: UP045
    parallel: Annotated[bool, typer.Option("--parallel", help="step each environment in a process of its own")] = False,
    randomise: Annotated[
        bool, typer.Option("--randomise", help="draw other effects around the model in every episode")
    ] = False,
    tune: Annotated[
        int, typer.Option(min=0, help="search hyperparameters in so many short trainings instead", metavar="TRIALS")
    ] = 0,
    again: Annotated[
        bool, typer.Option("--again", help="replace what the folder holds of an earlier training")
    ] = False,
) -> None:
    """Train an agent on top of a model's feedforward.

    It learns in the simulator made from that model, and is tried on an arm with hidden effects.
    """
    from agents.training.settings import read_settings
    from gapscope.train import train_files

    settings = read_settings(agent, steps=steps, seed=seed, engine=engine, parallel=parallel or None)
    if randomise:
        settings = settings.randomised()
    with _Progress(model) as progress:
        content, paths = train_files(
            model, robot, effects, settings, out, again=again, trials=tune, progress=progress
        )  # fmt: skip
    for line in _learnt(content) if content else ():
        _console.print(line, highlight=False, markup=False, soft_wrap=True)
    _wrote(*paths)


def _learnt(content: dict[str, Any]) -> list[str]:
    """Joint error before and after training, in the simulator and on the hidden arm."""
    lines = []
    for part, where in (("simulator", "in the simulator made from the model"), ("hidden", "on the hidden arm")):
        scores = [content[key][part] for key in ("untrained", "kept")]
        if None not in scores:
            said = [
                "not tracked to the end" if s["joint_error"] is None else f"{1e3 * s['joint_error']:.3g} mrad"
                for s in scores
            ]
            lines.append(f"joint error {where}: {said[0]} untrained, {said[1]} trained")
    return lines


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


@app.command()
def export(
    corrected: Annotated[Path, typer.Argument(help="corrected.yaml of a diagnosis", metavar="CORRECTED")],
    out: Annotated[Path, typer.Option(help="file to write", metavar="FILE")],
    file_format: Annotated[str, typer.Option("--format", help="urdf, mjcf or sdf")],
    case: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="the case that was diagnosed: its nominal arm and data sheet", metavar="CASE"),
    ] = None,
    robot: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(help="in its place: kuka_iiwa, ..., or a URDF", metavar="ROBOT"),
    ] = None,
    relative_meshes: Annotated[
        bool, typer.Option("--relative-meshes", help="name meshes from the folder of FILE, not absolutely")
    ] = False,
) -> None:
    """Write the corrected arm for other simulators.

    What the format cannot hold is listed in the file and on the terminal.
    """
    from gapscope.export import export_file

    with _Progress(corrected.name) as progress:
        progress(f"writes {file_format}")
        missing, odd = export_file(corrected, case, robot, file_format, out, relative_meshes)
    for title, lines in (
        (f"left out of {out.name}:", missing),
        ("odd:", odd),
    ):
        for line in (title, *(f"  {each}" for each in lines)) if lines else ():
            _console.print(line, highlight=False, markup=False, soft_wrap=True)
    _wrote(out)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="folder for the case and the results", metavar="DIR")] = Path(
        "gapscope-demo"
    ),
    seed: Annotated[Optional[int], typer.Option(help="draw the same mystery arm again")] = None,  # noqa: UP045
) -> None:
    """Record a mystery arm, diagnose it, and open the truth."""
    from gapscope.mystery import play

    with _Progress("mystery arm") as progress:
        paths = play(out, seed, progress, _console)
    _wrote(*paths)


def _wrote(*paths: Path) -> None:
    for path in paths:
        _console.print(f"wrote {path}", highlight=False, soft_wrap=True)


def _show_warning(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    """What is odd about a model as a note; other warnings as Python shows them."""
    if issubclass(category, ModelWarning):
        _log.print(f"note: {message}", highlight=False, markup=False, soft_wrap=True)
    else:
        _python_warning(message, category, *place, **more)


def main(arguments: list[str] | None = None) -> Any:
    """Run a command; the process ends with 0, 1 (the work failed, said why) or 2 (bad input)."""
    warnings.showwarning = _show_warning
    try:
        app(args=arguments)
    except GapscopeError as error:
        _log.print(f"gapscope: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(error.exit_code)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer ends the process so, without a word
            _log.print("gapscope: interrupted; what was written is whole, run the command again for the rest")
        raise
