"""The truth of a simulated arm beside what was found, as a table on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from gapscope.arm.display import MISSING, display_unit, effect_name, significant
from gapscope.effects.applied import AppliedEffect

Key = tuple[str, str, str, str]
"""Effect, what it acts on, parameter, unit."""


def truth_table(
    truth: Sequence[AppliedEffect], found: Sequence[AppliedEffect]
) -> Table:
    """Truth and findings side by side, one row per parameter and joint."""
    table = Table(title="the truth, opened", title_justify="left")
    for heading in ("effect", "joint", "parameter"):
        table.add_column(heading)
    for heading in ("hidden", "found"):
        table.add_column(heading, justify="right")
    hidden_values, found_values = dict(_values(truth)), dict(_values(found))
    for key in hidden_values | found_values:
        name, joint, parameter, unit = key
        pair = (hidden_values.get(key), found_values.get(key))
        table.add_row(effect_name(name), joint, parameter, *_texts(pair, unit))
    return table


def _texts(values: Sequence[float | None], unit: str) -> list[str]:
    """Values as text, all in the one unit that suits the largest."""
    largest = max(abs(value) for value in values if value is not None)
    factor, label = display_unit(unit, largest)
    return [
        MISSING if value is None else f"{significant(value * factor)} {label}"
        for value in values
    ]


def _values(effects: Sequence[AppliedEffect]) -> Iterator[tuple[Key, float]]:
    """Each number of each effect; a vector has one per axis, a joint effect one per joint."""
    for applied in effects:
        for parameter in applied.effect.parameters:
            values = np.atleast_1d(applied.parameters[parameter.name])
            for i, value in enumerate(values):
                axis = f" {'xyz'[i]}" if parameter.size == 3 else ""
                place = str(applied.joints[i]) if applied.joints else "arm"
                name = parameter.name + axis
                yield (applied.name, place, name, parameter.unit), float(value)
