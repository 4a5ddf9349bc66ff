"""The command ``gapscope check``: whether a case can be diagnosed."""

from __future__ import annotations

import typer

from gapscope.commands.options import AsJson, CasePath
from gapscope.terminal import Progress, show

CANNOT = 2
"""Exit code if the case cannot be diagnosed."""


def check(case: CasePath, as_json: AsJson = False) -> None:
    """Say in seconds whether a case can be diagnosed, and what its recordings cannot tell."""
    from gapscope.interface.check import check as check_case

    with Progress(case.name or str(case)) as progress:
        result = check_case(case, progress=progress)
    show(result, as_json=as_json)
    if not result.can_be_diagnosed:
        raise typer.Exit(CANNOT)
