"""How often intervals of a diagnosis hold the values that were put in, as tables; see ``51_interval_coverage.py``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.blind_check.scoring.statistics import wilson
from gapscope.reports.blind_check.tables import Table

INTERVAL = 1.96
"""Standard deviations to either side in a 95 % interval [1]."""
LEFT_OUT = ("phase", "link")
"""Parameters that are not compared: a phase turns with the number of cycles, a link has no error."""


@dataclass(frozen=True)
class Value:
    """One value of an effect that was named rightly, on a joint that has it.

    Attributes:
        case: name of the case.
        group: what it is of: width of the nominal errors, or the arm.
        parameter: effect and parameter.
        true, found: the value that was put in, and the one of the diagnosis.
        half: half width of the 95 % interval.
    """

    case: str
    group: str
    parameter: str
    true: float
    found: float
    half: float

    @property
    def held(self) -> bool:
        """Whether the interval holds the true value."""
        return abs(self.found - self.true) <= self.half


def values(
    case: str, group: str, truth: dict[str, Any], document: dict[str, Any]
) -> Iterator[Value]:
    """The values of all effects of a label that the diagnosis names."""
    for true in truth["effects"]:
        for found in document.get("effects", []):
            if _same(true, found):
                for name, *numbers in _numbers(true, found):
                    yield Value(case, group, f"{true['effect']}.{name}", *numbers)


def _same(true: dict[str, Any], found: dict[str, Any]) -> bool:
    if true["effect"] != found["effect"]:
        return False
    links = [
        float(np.ravel(entry["parameters"]["link"]["value"])[0])
        for entry in (true, found)
        if "link" in entry["parameters"]
    ]
    return len(set(links)) < 2


def _numbers(
    true: dict[str, Any], found: dict[str, Any]
) -> Iterator[tuple[str, float, float, float]]:
    """Parameter, true value, value found and half width, joint by joint or component by component."""
    for name, stated in true["parameters"].items():
        estimate = found["parameters"].get(name)
        if estimate is None or estimate["std"] is None or name in LEFT_OUT:
            continue
        if not stated.get("unit"):
            # what only the generator's law has
            continue
        expected, value, std = (
            np.ravel(np.array(x, dtype=float))
            for x in (stated["value"], estimate["value"], estimate["std"])
        )
        places = range(len(expected))
        if true["joints"]:
            pairs = [
                (k, found["joints"].index(joint))
                for k, joint in enumerate(true["joints"])
                if joint in found["joints"]
            ]
        else:
            pairs = [(k, k) for k in places]
        for k, i in pairs:
            yield name, expected[k], value[i], INTERVAL * std[i]


def coverage_table(
    title: str, found: Sequence[Value], key: Callable[[Value], str]
) -> Table:
    """A row for each value of a key, and one for all."""
    groups: dict[str, list[Value]] = {}
    for value in found:
        groups.setdefault(key(value), []).append(value)
    rows = [_row(name, groups[name]) for name in sorted(groups)]
    head = ("", "values", "held", "95 % interval", "error / half width", "half width")
    return Table(title, head, (*rows, _row("all", found)))


def _row(name: str, found: Sequence[Value]) -> tuple[str, ...]:
    """Share held with Wilson's interval; medians of error over half width, and of half width over the true value."""
    held = sum(value.held for value in found)
    low, high = wilson(held, len(found))
    half = np.array([value.half for value in found])
    error = np.array([abs(value.found - value.true) for value in found])
    true = np.array([abs(value.true) for value in found])
    share = half / np.maximum(true, 1e-12)
    return (
        name,
        str(len(found)),
        f"{100 * held / len(found):.0f} %",
        f"{100 * low:.0f} to {100 * high:.0f} %",
        f"{np.median(error / np.maximum(half, 1e-12)):.2f}",
        f"{100 * np.median(share):.1f} %",
    )
