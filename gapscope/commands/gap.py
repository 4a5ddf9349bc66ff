"""The command ``gapscope gap``: the gap alone, without a diagnosis."""

from __future__ import annotations

from gapscope.commands.options import AsJson, CasePath, Model
from gapscope.terminal import Progress, note, show


def gap(case: CasePath, model: Model = None, as_json: AsJson = False) -> None:
    """Measure the gap alone, per joint, of a nominal or corrected arm."""
    from gapscope.interface.gap import gap as measure_gap

    with Progress(case.name or str(case)) as progress:
        progress("measures the gap")
        measured = measure_gap(case, model)
    show(measured, as_json=as_json)
    if not as_json:
        for warning in measured.document["warnings"]:
            note(f"note: {warning}")
