"""The command ``gapscope agree``: do the recordings of a case agree?"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from gapscope.commands.options import CasePath
from gapscope.terminal import Progress, console, wrote

Out = Annotated[
    Path | None,
    typer.Option(help="folder for agreement.html and agreement.json", metavar="DIR"),
]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON to standard output")]


def agree(case: CasePath, out: Out = None, as_json: AsJson = False) -> None:
    """Say which parameters agree in all recordings, and with what the others differ."""
    from gapscope.arm.io.json_file import to_json
    from gapscope.arm.io.locked_section import locked
    from gapscope.interface.agree import agree as compare
    from gapscope.reports.agreement import summary

    with Progress(case.name or str(case)) as progress, locked(out):
        result = compare(case, progress=progress)
        written = () if out is None else result.save(out)
    if as_json:
        sys.stdout.write(to_json(result.document))
        return
    console.print(summary(result.document))
    wrote(*written)
