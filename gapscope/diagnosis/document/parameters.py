"""The parameters of an effect found, with their standard deviations."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import SKEWS
from gapscope.effects.applied import AppliedEffect


def finding_of(applied: AppliedEffect) -> str:
    """What the terms of an effect are named with."""
    return (
        f"{applied.name} {int(applied.parameters['link'])}"
        if "link" in applied.parameters
        else applied.name
    )


def parameters(
    selection: Selection,
    applied: AppliedEffect,
    draws: np.ndarray,
    instrumented: AppliedEffect | None = None,
) -> dict[str, Any]:
    """Values with standard deviations: of linear coordinates from a block bootstrap, of shapes from their scan.

    A delay or lag is uncertain by the sampling skew as well. Of linear coordinates the values by the commands as
    instruments are added where they are known.
    """
    mine = [
        t
        for t in selection.evidence.terms.all
        if t in selection.fit.terms and t.finding == finding_of(applied)
    ]
    fitted = mine[0].parametrisation
    shapes = [selection.evidence.linear.shape(t) for t in mine]
    values = [np.array(s.values) for s in shapes]
    samples = [dict(fitted.values(*_coordinates(draw, mine, values))) for draw in draws]
    skew = SKEWS[1] if applied.effect.delays else 0.0
    out: dict[str, Any] = {}
    for parameter in applied.effect.parameters:
        value = applied.parameters[parameter.name]
        if parameter.name in fitted.nonlinear:
            std = np.array(
                [s.std[fitted.nonlinear.index(parameter.name)] for s in shapes]
            )
        elif parameter.name == "link":
            std = np.zeros(1)
        else:
            std = _spread(
                np.clip(
                    [sample[parameter.name] for sample in samples], *parameter.bounds
                )
            )
        std = np.hypot(std, skew).reshape(value.shape)
        out[parameter.name] = {
            "unit": parameter.unit,
            "value": value.tolist(),
            "std": std.tolist(),
        }
        if instrumented is not None and parameter.name not in (
            *fitted.nonlinear,
            "link",
        ):
            out[parameter.name]["by_commands"] = instrumented.parameters[
                parameter.name
            ].tolist()
    return out


def _coordinates(
    draw: np.ndarray, terms: list[Term], shapes: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Linear coordinates (linear, m) and shapes (s, m) of the terms of one finding."""
    return np.array([draw[list(t.columns)] for t in terms]).T, np.array(shapes).T


def _spread(samples: np.ndarray) -> np.ndarray:
    """Half the distance between the 16th and the 84th percentile over the draws: a quotient has wild ones."""
    low, high = np.percentile(samples, [15.87, 84.13], axis=0)
    return 0.5 * (high - low)
