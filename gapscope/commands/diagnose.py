"""The command ``gapscope diagnose``: one case, several cases, or a case against a reference."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from gapscope.commands.options import Positive, Results
from gapscope.terminal import Progress, say, show, wrote

LOADS = "loads the libraries"
"""The first line of progress; it comes before the imports, which take a second or two."""


def diagnose(
    cases: Annotated[list[Path], Argument(metavar="CASE...")],
    *,
    out: Results,
    jobs: Positive = 1,
    backend: str = "local",
    again: bool = False,
    against: Annotated[Path | None, Option(metavar="REFERENCE")] = None,
) -> None:
    """Find where the gap lies, what causes it, and how far it closes.

    Args:
        cases: folders of cases, or case files
        jobs: cases at a time, if there are several
        backend: local, or ray (a cluster; needs ray installed)
        again: re-diagnose cases that already have results
        against: case of the same arm, known healthy and without load, or the folder identified/ of an earlier
            comparison with it: what changed?
    """
    if len(cases) > 1:
        with Progress(f"{len(cases)} cases") as progress:
            progress(LOADS)
            from gapscope.many.batch import (
                SUMMARY,
                UNITS,
                Batch,
                diagnose_all,
            )

            batch = Batch(tuple(cases), out, jobs, backend, again, against)
            code = diagnose_all(batch, progress)
        # units are compared, and written, only if some are of one type
        wrote(*(out / name for name in (SUMMARY, UNITS) if (out / name).is_file()))
        raise typer.Exit(code)
    # one case has its results in the folder itself, without one of its own
    case = cases[0]
    with Progress(case) as progress:
        progress(LOADS)
        from gapscope.many.batch import diagnose_path
        from gapscope.many.workers import check_backend
        from gapscope.reports.diagnosis import CASE, CORRECTED, actions

        check_backend(backend)
        result, paths = diagnose_path(case, out, progress, against=against)
    show(result, *paths)
    if against is not None:
        identified, corrected = (shlex.quote(str(out / x)) for x in (CASE, CORRECTED))
        say(
            "to predict with what was found: "
            f"gapscope predict {identified} --model {corrected} ..."
        )
    for action in actions(result.diagnosis, out):
        # all else is said above
        if action.command.startswith("gapscope"):
            say(f"{action.text.partition(':')[0]}: {action.command}")
