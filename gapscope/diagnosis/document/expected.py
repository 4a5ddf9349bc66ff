"""How large effects would have to be for recordings to show them, as documents have it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from gapscope.model.expected import Detectable


def expected_entries(found: Iterable[Detectable]) -> list[dict[str, Any]]:
    """``expected`` of a document."""
    entries = []
    for one in found:
        fitted, term = one.term.parametrisation, one.term
        apart = ("link", *fitted.nonlinear)
        parameter = next(p for p in term.definition.parameters if p.name not in apart)
        shape = np.array(one.shape).reshape(-1, 1)
        low, high = parameter.bounds
        values: list[float | None] = []
        for size in (one.half, one.most):
            coordinates = np.zeros((fitted.linear, 1))
            coordinates[0] = size if np.isfinite(size) else 0.0
            found_value = np.ravel(fitted.values(coordinates, shape)[parameter.name])[0]
            # what cannot be is never named
            possible = np.isfinite(size) and low <= found_value <= high
            values.append(float(found_value) if possible else None)
        entries.append(
            {
                "effect": term.effect,
                "joints": [term.joint] if term.joint else [],
                "parameter": parameter.name,
                "unit": parameter.unit,
                "half": values[0],
                "nine_of_ten": values[1],
            }
        )
    return entries
