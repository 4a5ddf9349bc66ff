"""The command ``gapscope check``: whether a case can be diagnosed."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from gapscope.commands.options import CasePath
from gapscope.terminal import Progress, console

AsJson = Annotated[bool, typer.Option("--json", help="print JSON to standard output")]
CANNOT = 2
"""Exit code if the case cannot be diagnosed."""


def check(case: CasePath, as_json: AsJson = False) -> None:
    """Say in seconds whether a case can be diagnosed, and what its recordings cannot tell."""
    from gapscope.arm.io.json_file import to_json
    from gapscope.interface.check import check as check_case
    from gapscope.reports.case_check import summary

    with Progress(case.name or str(case)) as progress:
        result = check_case(case, progress=progress)
    if as_json:
        sys.stdout.write(to_json(result.document))
    else:
        console.print(summary(result.document))
    if not result.can_be_diagnosed:
        raise typer.Exit(CANNOT)
