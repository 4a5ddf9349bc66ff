"""The commands that show the installation at work: ``demo`` and ``doctor``."""

from __future__ import annotations

import platform
from pathlib import Path
from time import monotonic

import typer

from gapscope.commands.options import Folder
from gapscope.terminal import Progress, console, say, show, wrote

CAVEAT = (
    "This is a recovery check: recorded and explained with the same definitions of the effects. "
    "It shows that the chain works, not how accurate it is on a real arm."
)


def demo(
    *,
    out: Folder = Path("gapscope-demo"),
    seed: int | None = None,
) -> None:
    """Record a mystery arm, diagnose it, and open the truth.

    Args:
        out: folder for the case and the results
        seed: draw the same mystery arm again
    """
    import numpy as np

    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.io.write_case import write_case
    from gapscope.effects.corrected_file import write_corrected
    from gapscope.envs.engines import default_engine
    from gapscope.envs.mystery_arm import mystery_arm
    from gapscope.many.batch import diagnose_path
    from gapscope.reports.truth_table import truth_table

    start = monotonic()
    # drawn here, so that it can be told and drawn again
    seed = int(np.random.default_rng().integers(2**31)) if seed is None else seed
    with Progress("mystery arm") as progress, locked(out):
        engine = default_engine()
        progress(
            f"draws one or two effects and records a simulated KUKA iiwa in {engine}"
        )
        case, truth = mystery_arm(np.random.default_rng(seed))
        write_case(case, out / "case", overwrite=True)
        progress("diagnoses the recordings; the truth stays closed")
        # from the files alone
        result, (report, *_) = diagnose_path(out / "case", out / "diagnosis", progress)
        write_corrected(case.name, truth, out / "truth.yaml")
    show(result)
    console.print(truth_table(truth, result.effects))
    console.print(CAVEAT, style="italic")
    console.print(f"seed {seed}, {monotonic() - start:.0f} s", highlight=False)
    wrote(out / "case" / "case.yaml", report, out / "truth.yaml")


def doctor() -> None:
    """Say what is installed, what is missing for which command, and whether the engines agree."""
    from rich.text import Text

    from gapscope import __version__
    from gapscope.installation import check_engines, packages
    from gapscope.reports.pages import terminal_table

    say(
        f"gapscope {__version__}, Python {platform.python_version()}, {platform.platform()}"
    )
    found = packages()
    rows = []
    for package in found:
        remedy = "" if package.version else package.remedy
        row = (package.name, package.version or "missing", package.needed_for, remedy)
        rows.append([Text(cell, "yellow" if remedy else "") for cell in row])
    heads = ("package", "version", "for", "remedy")
    console.print(terminal_table(heads, rows, len(heads)))
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
    # extras that are missing are no fault
    lacking = [p.name for p in found if p.version is None and not p.extra]
    wrong = [check.engine for check in checks if not check.agrees]
    if lacking or wrong:
        say(f"not in order: {', '.join(lacking + wrong)}")
        raise typer.Exit(1)
    say("in order; what is missing is needed for the commands beside it alone")
