"""The command ``gapscope doctor``: what is installed, what is missing for which command, and whether engines agree."""

from __future__ import annotations

import platform

import typer

from gapscope.terminal import Progress, console, say


def doctor() -> None:
    """Say what is installed, what is missing for which command, and whether the engines agree."""
    from rich.table import Table
    from rich.text import Text

    from gapscope import __version__
    from gapscope.installation import check_engines, packages

    say(
        f"gapscope {__version__}, Python {platform.python_version()}, {platform.platform()}"
    )
    found = packages()
    table = Table("package", "version", "for", "remedy")
    for package in found:
        missing = package.version is None
        remedy = package.remedy if missing else ""
        row = (package.name, package.version or "missing", package.needed_for, remedy)
        cells = (Text(cell) for cell in row)  # a text: brackets are no markup
        table.add_row(*cells, style="yellow" if missing else None)
    console.print(table)
    with Progress("engines") as progress:
        progress("compares them with pinocchio")
        checks = check_engines()
    for check in checks:
        if check.difference is None:
            say(f"{check.engine}: cannot be run: {check.problem}")
        else:
            verdict = "agrees" if check.agrees else "DOES NOT AGREE"
            say(
                f"{check.engine}: {verdict} with pinocchio, accelerations differ by {check.difference:.1e}"
            )
    lacking = [p.name for p in found if p.version is None and not p.extra]
    wrong = [check.engine for check in checks if not check.agrees]
    if lacking or wrong:
        say(f"not in order: {', '.join(lacking + wrong)}")
        raise typer.Exit(1)
    say("in order; what is missing is needed for the commands beside it alone")
