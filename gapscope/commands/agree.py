"""The command ``gapscope agree``: do the recordings of a case agree?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import AsJson, CasePath
from gapscope.terminal import Progress, show


def agree(
    case: CasePath,
    out: Annotated[
        Path | None,
        Option(help="folder for agreement.html and agreement.json", metavar="DIR"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say which parameters agree in all recordings, and with what the others differ."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.interface.agree import agree as compare

    with Progress(case.name or str(case)) as progress, locked(out):
        result = compare(case, progress=progress)
        written = () if out is None else result.save(out)
    show(result, *written, as_json=as_json)
