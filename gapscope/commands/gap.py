"""The command ``gapscope gap``: the gap alone, without a diagnosis."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from gapscope.commands.options import CasePath, Model
from gapscope.terminal import Progress, console, note

AsJson = Annotated[bool, typer.Option("--json", help="print JSON to standard output")]


def gap(case: CasePath, model: Model = None, as_json: AsJson = False) -> None:
    """Measure the gap alone, per joint, of a nominal or corrected arm."""
    from gapscope.arm.io.json_file import to_json
    from gapscope.interface.gap import gap as measure_gap
    from gapscope.reports.gap import gap_tables

    with Progress(case.name or str(case)) as progress:
        progress("measures the gap")
        measured = measure_gap(case, model).document
    if as_json:
        sys.stdout.write(to_json(measured))
    else:
        console.print(gap_tables(measured))
        for warning in measured["warnings"]:
            note(f"note: {warning}")
