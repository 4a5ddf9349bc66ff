"""The truth of a simulated arm beside what was found, as a table on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from gapscope.arm.display import MISSING, display_unit, effect_name, significant
from gapscope.diagnosis.document.numbers import Number, numbers_of
from gapscope.effects.applied import AppliedEffect
from gapscope.reports.pages import terminal_table


def truth_table(
    truth: Sequence[AppliedEffect], found: Sequence[AppliedEffect]
) -> Table:
    """Truth and findings side by side, one row per parameter and joint."""
    hidden_values, found_values = _values(truth), _values(found)
    rows = []
    # what was missed and what was invented have rows, too
    for number in hidden_values | found_values:
        values = [hidden_values.get(number), found_values.get(number)]
        # all in the one unit that suits the largest
        largest = max(abs(value) for value in values if value is not None)
        factor, unit = display_unit(number.unit, largest)
        texts = [
            MISSING if value is None else f"{significant(value * factor)} {unit}"
            for value in values
        ]
        place = str(number.joint or number.link or "arm")
        name = f"{number.parameter} {number.component}".rstrip()
        rows.append((effect_name(number.effect), place, name, *texts))
    heads = ("effect", "joint", "parameter", "hidden", "found")
    return terminal_table(heads, rows, 3, title="the truth, opened")


def _values(effects: Sequence[AppliedEffect]) -> dict[Number, float]:
    """Each number of each effect, by all that tells it from others."""
    entries = [
        {
            "effect": applied.name,
            "joints": list(applied.joints),
            "parameters": {
                p.name: {
                    "value": applied.parameters[p.name],
                    "std": None,
                    "unit": p.unit,
                }
                for p in map(applied.effect.parameter, applied.given)
            },
        }
        for applied in effects
    ]
    return {
        # without its value a number is the same in truth and finding
        number._replace(value=None): float(number.value or 0.0)
        for entry in entries
        for number in numbers_of(entry)
    }
