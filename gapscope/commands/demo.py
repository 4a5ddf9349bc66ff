"""The demonstration: a mystery arm is recorded and diagnosed, then the truth is opened beside the verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import monotonic

import numpy as np
from rich.console import Console
from rich.table import Table

from gapscope.arm.io.write_case import write_case
from gapscope.commands.diagnose import diagnose_path, make_folder
from gapscope.diagnosis.display import display_unit, significant
from gapscope.diagnosis.document.wording import effect_name
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.envs.mystery_arm import mystery_arm
from gapscope.reports.diagnosis.terminal_summary import print_summary

CAVEAT = (
    "This is a recovery check: recorded and explained with the same definitions of the effects. "
    "It shows that the chain works, not how accurate it is on a real arm."
)


def play(
    out: Path, seed: int | None, progress: Callable[[str], None], console: Console
) -> list[Path]:
    """Record, diagnose from the files alone, and compare; returns what was written."""
    make_folder(out)
    start = monotonic()
    seed = int(np.random.default_rng().integers(2**31)) if seed is None else seed
    progress("draws one or two effects and records a simulated KUKA iiwa in PyBullet")
    case, truth = mystery_arm(np.random.default_rng(seed))
    write_case(case, out / "case", overwrite=True)
    progress("diagnoses the recordings; the truth stays closed")
    result = diagnose_path(out / "case", out / "diagnosis", progress)
    write_corrected(case.name, truth, out / "truth.yaml")
    print_summary(result.document, console)
    console.print(_comparison(truth, result.effects))
    console.print(CAVEAT, style="italic")
    console.print(f"seed {seed}, {monotonic() - start:.0f} s", highlight=False)
    return [
        out / "case" / "case.yaml",
        out / "diagnosis" / "report.html",
        out / "truth.yaml",
    ]


def _comparison(
    truth: tuple[AppliedEffect, ...], found: tuple[AppliedEffect, ...]
) -> Table:
    """Truth and verdict side by side, one row per parameter and joint."""
    table = Table(title="the truth, opened", title_justify="left")
    for heading in ("effect", "joint", "parameter"):
        table.add_column(heading)
    for heading in ("hidden", "found"):
        table.add_column(heading, justify="right")
    hidden, said = _values(truth), _values(found)
    for key in [*hidden, *(k for k in said if k not in hidden)]:
        name, joint, parameter, unit = key
        values = [v.get(key, None) for v in (hidden, said)]
        factor, label = display_unit(unit, max(abs(v) for v in values if v is not None))
        texts = [
            "–" if v is None else f"{significant(v * factor)} {label}" for v in values
        ]
        table.add_row(effect_name(name), joint, parameter, *texts)
    return table


def _values(
    effects: tuple[AppliedEffect, ...],
) -> dict[tuple[str, str, str, str], float]:
    out = {}
    for applied in effects:
        for parameter in applied.effect.parameters:
            values = np.atleast_1d(applied.parameters[parameter.name])
            labels = [str(j) for j in applied.joints] or ["arm"]
            for i, value in enumerate(values):
                axis = f" {'xyz'[i]}" if parameter.size == 3 else ""
                label = labels[i] if applied.joints else labels[0]
                out[(applied.name, label, parameter.name + axis, parameter.unit)] = (
                    float(value)
                )
    return out
