"""The command ``gapscope demo``: a mystery arm, recorded and diagnosed, then the truth beside the verdict."""

from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import Annotated

from typer import Option

from gapscope.terminal import Progress, console, show, wrote

CAVEAT = (
    "This is a recovery check: recorded and explained with the same definitions of the effects. "
    "It shows that the chain works, not how accurate it is on a real arm."
)


def demo(
    out: Annotated[
        Path, Option(help="folder for the case and the results", metavar="DIR")
    ] = Path("gapscope-demo"),
    seed: Annotated[int | None, Option(help="draw the same mystery arm again")] = None,
) -> None:
    """Record a mystery arm, diagnose it, and open the truth."""
    import numpy as np

    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.io.write_case import write_case
    from gapscope.commands.diagnose_path import diagnose_path
    from gapscope.effects.corrected_file import write_corrected
    from gapscope.envs.engines import default_engine
    from gapscope.envs.mystery_arm import mystery_arm
    from gapscope.reports.truth_table import truth_table

    start = monotonic()
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
