"""The commands that look for a gap and its causes: diagnose, predict, replay, gap and advise."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from gapscope.arm.errors import InputError
from gapscope.commands.options import (
    Acceleration,
    CasePath,
    Clearance,
    Collisions,
    Engine,
    Margin,
    Model,
    Rate,
    Results,
    SearchSeed,
    Singular,
    Surface,
    Torque,
    Trajectory,
    Velocity,
)
from gapscope.terminal import Progress, console, log, wrote


def diagnose(
    cases: Annotated[
        list[Path],
        typer.Argument(help="folders of cases, or case files", metavar="CASE..."),
    ],
    out: Results,
    jobs: Annotated[
        int, typer.Option(min=1, help="cases at a time, where there are several")
    ] = 1,
    backend: Annotated[
        str, typer.Option(help="local, or ray (a cluster; needs ray installed)")
    ] = "local",
    again: Annotated[
        bool,
        typer.Option(
            "--again",
            help="of several cases, diagnose also those that an earlier run has finished",
        ),
    ] = False,
    against: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="case of the same arm, known healthy and without load: what changed?",
            metavar="REFERENCE",
        ),
    ] = None,
) -> None:
    """Find where the gap lies, what causes it, and how far it closes."""
    if against is not None:
        _diagnose_against(cases, against, out)
        return
    if len(cases) == 1:
        from gapscope.commands.diagnose import diagnose_path
        from gapscope.reports.diagnosis.terminal_summary import print_summary

        with Progress(cases[0].name or str(cases[0])) as progress:
            result = diagnose_path(cases[0], out, progress)
        print_summary(result.document, console)
        wrote(out / "report.html", out / "diagnosis.json", out / "corrected.yaml")
        return
    from gapscope.commands.diagnose_batch import SUMMARY, UNITS, Batch, diagnose_all

    with Progress(f"{len(cases)} cases") as progress:
        code = diagnose_all(
            Batch(tuple(cases), out, jobs, backend, again), progress, console
        )
    wrote(*(out / name for name in (SUMMARY, UNITS) if (out / name).is_file()))
    raise typer.Exit(code)


def _diagnose_against(cases: list[Path], reference: Path, out: Path) -> None:
    from gapscope.commands.diagnose_against import CASE, URDF, diagnose_against
    from gapscope.reports.diagnosis.terminal_summary import print_summary

    if len(cases) > 1:
        raise InputError(
            "takes one case at a time",
            "run the command once for each case",
            where="--against",
        )
    with Progress(cases[0].name or str(cases[0])) as progress:
        change = diagnose_against(cases[0], reference, out, progress)
    print_summary(change.diagnosis.document, console)
    wrote(
        *(
            out / name
            for name in ("report.html", "diagnosis.json", "corrected.yaml", CASE, URDF)
        )
    )
    console.print(
        f"to predict with what was found: gapscope predict {out / CASE} --model {out / 'corrected.yaml'} ...",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def predict(
    case: CasePath,
    recording: Annotated[
        Path,
        typer.Option(
            help="recording with t, q1..; other columns are not used", metavar="FILE"
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="CSV to write: t, tau1..", metavar="FILE.csv")
    ],
    model: Model = None,
) -> None:
    """Predict the torque that a model says would be recorded."""
    from gapscope.arm.io.write_case import write_columns
    from gapscope.commands.diagnose import corrected_arm, load_for_prediction
    from gapscope.diagnosis.gap.predict import predict_torque

    with Progress(recording.name) as progress:
        progress("reads")
        arm, motion = load_for_prediction(case, recording)
        progress("predicts")
        torque = predict_torque(corrected_arm(arm, model), motion)
        write_columns(
            {
                "t": motion.t,
                **{f"tau{j + 1}": torque[:, j] for j in range(arm.n_joints)},
            },
            out,
        )
    wrote(out)


def replay(
    case: CasePath,
    recording: Annotated[
        Path,
        typer.Option(help="recording with q_ref1.., or tau1.. without", metavar="FILE"),
    ],
    out: Annotated[
        Path, typer.Option(help="CSV to write: t, q1.., tau1..", metavar="FILE.csv")
    ],
    model: Model = None,
    engine: Engine = "pybullet",
) -> None:
    """Move the simulated arm under the same commands as a recording."""
    from gapscope.arm.io.write_case import write_columns
    from gapscope.commands.diagnose import replay_file
    from gapscope.commands.gap import replay_line

    with Progress(recording.name) as progress:
        replayed = replay_file(case, recording, model, engine, progress)
        columns = {
            f"{name}{j + 1}": x
            for name in ("q", "tau")
            for j, x in enumerate(getattr(replayed, name).T)
        }
        write_columns({"t": replayed.t, **columns}, out)
    console.print(replay_line(replayed), highlight=False, soft_wrap=True)
    wrote(out)


def gap(
    case: CasePath,
    model: Model = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print JSON to standard output")
    ] = False,
) -> None:
    """Measure the gap alone, per joint, of a nominal or corrected arm."""
    from gapscope.arm.case import load_case
    from gapscope.arm.io.json_file import to_json
    from gapscope.commands.diagnose import corrected_arm
    from gapscope.commands.gap import gap_document, gap_tables

    with Progress(case.name or str(case)) as progress:
        progress("measures the gap")
        loaded = load_case(case)
        measured = gap_document(loaded, corrected_arm(loaded.arm, model))
    if as_json:
        sys.stdout.write(to_json(measured))
    else:
        console.print(gap_tables(measured, loaded.arm.joints))


def advise(
    case: CasePath,
    out: Trajectory,
    diagnosis: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="folder that diagnose wrote for this case; default: diagnose it now",
            metavar="DIR",
        ),
    ] = None,
    payload: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            help="mass of a known body that could be mounted; used where it separates better [kg]"
        ),
    ] = None,
    payload_com: Annotated[
        str,
        typer.Option(
            help="its centre in the frame of the joint that moves the last link, x,y,z [m]"
        ),
    ] = "0,0,0",
    fastest: Annotated[
        float, typer.Option(help="highest frequency that the controller follows [Hz]")
    ] = 5.0,
    rate: Rate = 250.0,
    evaluations: Annotated[
        int, typer.Option(min=1, help="candidates to judge, over all speeds and loads")
    ] = 1000,
    velocity: Velocity = 1.5,
    acceleration: Acceleration = 5.0,
    torque: Torque = 0.8,
    margin: Margin = 0.1,
    singular: Singular = 0.02,
    clearance: Clearance = 0.01,
    surface: Surface = 0.0,
    collisions: Collisions = True,
    seed: SearchSeed = None,
) -> None:
    """Design the recording that separates what is still confounded."""
    from gapscope.commands.advise import check_out, findings, payload_of, write_advice
    from gapscope.commands.excite import SearchProgress, margin_lines, margin_table
    from gapscope.diagnosis.advice.advice_wording import lines
    from gapscope.diagnosis.advice.next_recording import Request
    from gapscope.ident.excitation.excitation_plan import LimitPlan

    check_out(out)
    limits = LimitPlan(
        velocity, acceleration, torque, margin, singular, clearance, surface, collisions
    )
    request = Request(
        limits, payload_of(payload, payload_com), fastest, rate, evaluations, seed
    )
    label = case.name or str(case)
    with Progress(label) as progress:
        loaded, found = findings(case, diagnosis, progress)
    with SearchProgress(label, "separation", log) as search:
        advice, paths = write_advice(loaded, found, request, out, search)
    if advice.excitation is not None:
        console.print(margin_table(advice.excitation))
        for line in margin_lines(advice.excitation):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    for line in lines(advice, found[0]):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrote(*paths)
