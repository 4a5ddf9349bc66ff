"""The parameters of several effects as one vector, to fit them and to differentiate by them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.thresholds import LEAST_PARAMETER_SCALE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.effect import Parameter

FIXED = ("link", "start", "end", "cycles")
"""Parameters that are not fitted: a name, times that belong to one recording, a count of teeth or poles."""
FARTHEST = 1e6
"""Stands for bounds that are farther away, in units of a parameter's scale [1]."""


def free(
    effects: tuple[AppliedEffect, ...],
) -> Iterator[tuple[int, Parameter, np.ndarray]]:
    """Index of the effect, parameter and values (m,) of all that is fitted, in the order of the vector."""
    for index, applied in enumerate(effects):
        for parameter in applied.effect.parameters:
            if parameter.name not in FIXED:
                yield (
                    index,
                    parameter,
                    np.atleast_1d(applied.parameters[parameter.name]).ravel(),
                )


def vector(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """The values, SI units, shape (P,)."""
    return np.concatenate([np.zeros(0), *(values for _, _, values in free(effects))])


def scales(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """Size of each value, for steps and for conditioning, same units, shape (P,)."""
    parts = [
        np.maximum(np.abs(v), LEAST_PARAMETER_SCALE * max(abs(x) for x in p.typical))
        for _, p, v in free(effects)
    ]
    return np.concatenate([np.zeros(0), *parts])


def bounds(effects: tuple[AppliedEffect, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds, each of shape (P,)."""
    low, high = (
        np.concatenate(
            [np.zeros(0), *(np.full(len(v), p.bounds[k]) for _, p, v in free(effects))]
        )
        for k in (0, 1)
    )
    far = FARTHEST * scales(effects)
    return np.maximum(low, -far), np.minimum(high, far)


def with_values(
    effects: tuple[AppliedEffect, ...], values: np.ndarray
) -> tuple[AppliedEffect, ...]:
    """The effects with other values, shape (P,), moved into their bounds."""
    changed: list[dict[str, np.ndarray]] = [
        dict(applied.parameters) for applied in effects
    ]
    start = 0
    for index, parameter, old in free(effects):
        new = np.clip(values[start : start + len(old)], *parameter.bounds)
        changed[index][parameter.name] = new.reshape(
            np.shape(effects[index].parameters[parameter.name])
        )
        start += len(old)
    return tuple(
        replace(applied, parameters=c)
        for applied, c in zip(effects, changed, strict=True)
    )
