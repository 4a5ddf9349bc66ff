"""The parameters of an effect found, with their standard deviations."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import SKEWS
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.parameter import Parameter
from gapscope.model.terms import Term

INTERVAL = 1.96
"""Standard deviations to either side of a value in a 95 % interval [1]."""


def finding_of(applied: AppliedEffect) -> str:
    """Name of an effect's finding: all joints of an effect together, each link on its own."""
    if "link" in applied.parameters:
        return f"{applied.name} {int(applied.parameters['link'])}"
    return applied.name


def parameters(
    selection: Selection,
    applied: AppliedEffect,
    draws: np.ndarray,
    instrumented: AppliedEffect | None = None,
) -> dict[str, Any]:
    """Values with standard deviations, by the names of the parameters.

    Args:
        selection: result of the search.
        applied: the effect with its values.
        draws: values of all terms as likely as the data make them, (draws, P).
        instrumented: the effect with values by the commands as instruments, if these are known; they are added for
            parameters that act linearly.
    """
    known, finding = selection.evidence.terms, finding_of(applied)
    terms = [t for t in known.all if t in selection.fit.terms and t.finding == finding]
    nonlinear = terms[0].parametrisation.nonlinear
    samples = _samples(selection, terms, draws)

    out: dict[str, Any] = {}
    for parameter in applied.effect.parameters:
        name, value = parameter.name, applied.parameters[parameter.name]
        if name in nonlinear:
            std = _scan_std(selection, terms, nonlinear.index(name))
        elif name == "link":
            std = np.zeros(1)
        else:
            std = std_of_draws(parameter, value, samples)

        # A skew of sampling acts as a delay: delays and lags are not known better than it.
        skew = SKEWS[1] if applied.effect.delays else 0.0
        std = np.hypot(std, skew).reshape(value.shape)
        entry = {
            "unit": parameter.unit,
            "value": value.tolist(),
            "std": std.tolist(),
        }
        fitted_linearly = name not in (*nonlinear, "link")
        if instrumented is not None and fitted_linearly:
            entry["by_commands"] = instrumented.parameters[name].tolist()
        out[name] = entry
    return out


def _scan_std(selection: Selection, terms: list[Term], place: int) -> np.ndarray:
    """Standard deviation of a parameter that acts nonlinearly, from its scan, (m,) for m terms."""
    scanned = [selection.evidence.linear.nonlinear(term) for term in terms]
    return np.array([shape.std[place] for shape in scanned])


def _samples(
    selection: Selection, terms: list[Term], draws: np.ndarray
) -> list[dict[str, np.ndarray]]:
    """Parameters of an effect on each draw of the linear coordinates, others at their values."""
    scanned = [selection.evidence.linear.nonlinear(term).values for term in terms]
    nonlinear = np.array(scanned).T

    # Places of the linear coordinates in theta, (linear, m).
    columns = np.array([term.columns for term in terms], dtype=int).T
    to_values = terms[0].parametrisation.values
    return [dict(to_values(draw[columns], nonlinear)) for draw in draws]


def std_of_draws(
    parameter: Parameter, value: np.ndarray, samples: list[dict[str, np.ndarray]]
) -> np.ndarray:
    """The deviation whose 1.96-fold holds 95 % of the draws to either side of a value.

    Not that of the draws: they are no Gaussian, a quotient of coordinates has some without bound, and what is likely
    under other errors of the nominal arm may lie to one side of the value.
    """
    drawn = np.array([sample[parameter.name] for sample in samples])
    inside = np.clip(drawn.reshape(len(drawn), *value.shape), *parameter.bounds)
    return np.asarray(np.quantile(np.abs(inside - value), 0.95, axis=0) / INTERVAL)
