"""The command ``gapscope diagnose``: one case, several cases, or a case against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gapscope.arm.errors import InputError
from gapscope.commands.options import Results
from gapscope.terminal import Progress, console, say, wrote

Cases = Annotated[
    list[Path],
    typer.Argument(help="folders of cases, or case files", metavar="CASE..."),
]
Jobs = Annotated[int, typer.Option(min=1, help="cases at a time, if there are several")]
Backend = Annotated[
    str, typer.Option(help="local, or ray (a cluster; needs ray installed)")
]
Again = Annotated[
    bool,
    typer.Option(
        "--again",
        help="of several cases, diagnose also those that an earlier run has finished",
    ),
]
Against = Annotated[
    Path | None,
    typer.Option(
        help="case of the same arm, known healthy and without load: what changed?",
        metavar="REFERENCE",
    ),
]


def diagnose(
    cases: Cases,
    out: Results,
    jobs: Jobs = 1,
    backend: Backend = "local",
    again: Again = False,
    against: Against = None,
) -> None:
    """Find where the gap lies, what causes it, and how far it closes."""
    if against is not None:
        _against(cases, against, out)
    elif len(cases) == 1:
        _one(cases[0], out)
    else:
        _several(cases, out, jobs, backend, again)


def _one(case: Path, out: Path) -> None:
    from gapscope.commands.diagnose_path import diagnose_path
    from gapscope.reports.diagnosis.terminal_summary import print_summary

    with Progress(case.name or str(case)) as progress:
        result, paths = diagnose_path(case, out, progress)
    print_summary(result.document, console)
    wrote(*paths)


def _several(
    cases: list[Path], out: Path, jobs: int, backend: str, again: bool
) -> None:
    from gapscope.commands.diagnosis_batch import SUMMARY, UNITS, Batch, diagnose_all

    batch = Batch(tuple(cases), out, jobs, backend, again)
    with Progress(f"{len(cases)} cases") as progress:
        code = diagnose_all(batch, progress)
    paths = (out / SUMMARY, out / UNITS)
    wrote(*(path for path in paths if path.is_file()))
    raise typer.Exit(code)


def _against(cases: list[Path], reference: Path, out: Path) -> None:
    from gapscope.commands.diagnose_path import diagnose_path
    from gapscope.outputs.diagnosis import CASE, CORRECTED
    from gapscope.reports.diagnosis.terminal_summary import print_summary

    if len(cases) > 1:
        raise InputError(
            "takes one case at a time",
            "run the command once for each case",
            where="--against",
        )
    case = cases[0]
    with Progress(case.name or str(case)) as progress:
        result, paths = diagnose_path(case, out, progress, against=reference)
    print_summary(result.document, console)
    wrote(*paths)
    say(
        "to predict with what was found: "
        f"gapscope predict {out / CASE} --model {out / CORRECTED} ..."
    )
