"""The command ``gapscope diagnose``: one case, several cases, or a case against a reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from gapscope.commands.options import Results
from gapscope.terminal import Progress, say, show, wrote

LOADS = "loads the libraries"
"""The first line of progress; it comes before the imports, which take a second or two."""


def diagnose(
    cases: Annotated[
        list[Path],
        Argument(help="folders of cases, or case files", metavar="CASE..."),
    ],
    out: Results,
    jobs: Annotated[
        int, Option(min=1, help="cases at a time, if there are several")
    ] = 1,
    backend: Annotated[
        str, Option(help="local, or ray (a cluster; needs ray installed)")
    ] = "local",
    again: Annotated[
        bool,
        Option(
            "--again",
            help="re-diagnose cases that already have results",
        ),
    ] = False,
    against: Annotated[
        Path | None,
        Option(
            help="case of the same arm, known healthy and without load, or the folder identified/ of an earlier "
            "comparison with it: what changed?",
            metavar="REFERENCE",
        ),
    ] = None,
) -> None:
    """Find where the gap lies, what causes it, and how far it closes."""
    if len(cases) > 1:
        _several(cases, out, jobs=jobs, backend=backend, again=again, against=against)
    elif against is None:
        case = cases[0]
        with Progress(case.name or str(case)) as progress:
            progress(LOADS)
            from gapscope.commands.diagnose_path import diagnose_path

            result, paths = diagnose_path(case, out, progress)
        show(result, *paths)
        _say_mended(paths)
    else:
        _against(cases[0], against, out)


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
