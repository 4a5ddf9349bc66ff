"""The parameters of several effects as one vector, to fit them and to differentiate by them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.thresholds import LEAST_PARAMETER_SCALE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.parameter import Parameter

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
    parts = [np.zeros(0)]
    for _, parameter, values in free(effects):
        largest = max(abs(value) for value in parameter.typical)
        parts.append(np.maximum(np.abs(values), LEAST_PARAMETER_SCALE * largest))
    return np.concatenate(parts)


def bounds(effects: tuple[AppliedEffect, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds, each of shape (P,)."""
    low, high = [np.zeros(0)], [np.zeros(0)]
    for _, parameter, values in free(effects):
        least, most = parameter.bounds
        low.append(np.full(len(values), least))
        high.append(np.full(len(values), most))
    far = FARTHEST * scales(effects)
    return np.maximum(np.concatenate(low), -far), np.minimum(np.concatenate(high), far)


def with_values(
    effects: tuple[AppliedEffect, ...], values: np.ndarray
) -> tuple[AppliedEffect, ...]:
    """The effects with other values, shape (P,), moved into their bounds."""
    changed = [dict(applied.parameters) for applied in effects]
    start = 0
    for index, parameter, old in free(effects):
        end = start + len(old)
        shape = np.shape(effects[index].parameters[parameter.name])
        new = np.clip(values[start:end], *parameter.bounds)
        changed[index][parameter.name] = new.reshape(shape)
        start = end
    return tuple(
        replace(applied, parameters=parameters)
        for applied, parameters in zip(effects, changed, strict=True)
    )
