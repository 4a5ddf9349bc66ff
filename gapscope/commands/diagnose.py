"""The command ``gapscope diagnose``: one case, several cases, or a case against a reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gapscope.commands.options import Results
from gapscope.terminal import Progress, say, show, wrote

LOADS = "loads the libraries"
"""The first line of progress; it comes before the imports, which take a second or two."""

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
        help="re-diagnose cases that already have results",
    ),
]
Against = Annotated[
    Path | None,
    typer.Option(
        help="case of the same arm, known healthy and without load, or the folder identified/ of an earlier "
        "comparison with it: what changed?",
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
    if len(cases) > 1:
        _several(cases, out, jobs=jobs, backend=backend, again=again, against=against)
    elif against is None:
        _one(cases[0], out)
    else:
        _against(cases[0], against, out)


def _one(case: Path, out: Path) -> None:
    with Progress(case.name or str(case)) as progress:
        progress(LOADS)
        from gapscope.commands.diagnose_path import diagnose_path

        result, paths = diagnose_path(case, out, progress)
    show(result, *paths)
    _say_mended(paths)


def _several(cases: Sequence[Path], out: Path, **options: Any) -> None:
    with Progress(f"{len(cases)} cases") as progress:
        progress(LOADS)
        from gapscope.commands.diagnosis_batch import (
            SUMMARY,
            UNITS,
            Batch,
            diagnose_all,
        )

        code = diagnose_all(Batch(tuple(cases), out, **options), progress)
    paths = (out / SUMMARY, out / UNITS)
    wrote(*(path for path in paths if path.is_file()))
    raise typer.Exit(code)


def _against(case: Path, reference: Path, out: Path) -> None:
    with Progress(case.name or str(case)) as progress:
        progress(LOADS)
        from gapscope.commands.diagnose_path import diagnose_path
        from gapscope.reports.diagnosis import CASE, CORRECTED

        result, paths = diagnose_path(case, out, progress, against=reference)
    show(result, *paths)
    say(
        "to predict with what was found: "
        f"gapscope predict {out / CASE} --model {out / CORRECTED} ..."
    )
    _say_mended(paths)


def _say_mended(paths: Sequence[Path]) -> None:
    """Say what the mended case is for, if there is one."""
    from gapscope.reports.mended_case import CASE

    for path in paths:
        if path.name == CASE:
            say(f"{path} reads the recordings right: give it to predict, gap, replay")
