"""Which inertial parameters base parameters give back, which only in combination, which not at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.ident.model.base_parameters import BaseParameters

RECOVERED, COMBINED, HIDDEN = "recovered", "only in combination", "not identifiable"
SHARE = 1e-5
"""Part of a parameter's direction outside what the torque depends on, beyond which it is not recovered alone [1]."""


@dataclass(frozen=True)
class Recovery:
    """Whether and how one parameter is determined.

    Attributes:
        name: of the parameter.
        unit: its unit.
        status: ``recovered``, ``only in combination`` or ``not identifiable``.
        reason: why, in words.
        nominal: value of the nominal arm.
        value: the value in the consistent set; of a parameter that is not recovered a choice near the nominal one.
        deviation: standard deviation, or ``None`` if the data do not determine the parameter alone.
    """

    name: str
    unit: str
    status: str
    reason: str
    nominal: float
    value: float
    deviation: float | None


def recoveries(
    base: BaseParameters,
    covariance: np.ndarray,
    value: np.ndarray,
    nominal: np.ndarray,
    units: Sequence[str],
) -> tuple[Recovery, ...]:
    """Whether and how each parameter of pi is determined.

    A parameter is recovered if its unit vector lies in the row space of C, beta = C pi: then pi_j = e_j^T C^+ beta.
    It is not identifiable if its column of C is zero: no torque depends on it.

    Args:
        base: C.
        covariance: of beta, shape (b, b).
        value: consistent pi, shape (p,).
        nominal: pi of the nominal arm, shape (p,).
        units: of pi, shape (p,).
    """
    inverse = np.linalg.pinv(base.combination)
    inside = np.einsum("pb,bp->p", inverse, base.combination)
    size = np.linalg.norm(base.combination, axis=0)
    expressions = base.expressions(1e-4)
    out = []
    for j, name in enumerate(base.names):
        deviation: float | None = None
        if size[j] <= 1e-9:
            status, reason = HIDDEN, "no torque in these recordings depends on it"
        elif inside[j] >= 1 - SHARE:
            status = RECOVERED
            deviation = float(np.sqrt(max(inverse[j] @ covariance @ inverse[j], 0.0)))
            reason = "the torque determines it alone"
            if deviation > abs(value[j]):
                reason = "the torque determines it alone, but not more exactly than its own size"
        else:
            status = COMBINED
            first = int(np.argmax(np.abs(base.combination[:, j])))
            reason = f"the torque depends on {shortened(expressions[first])}"
        out.append(
            Recovery(
                name=name,
                unit=units[j],
                status=status,
                reason=reason,
                nominal=float(nominal[j]),
                value=float(value[j]),
                deviation=deviation,
            )
        )
    return tuple(out)


def shortened(expression: str, terms: int = 4) -> str:
    """An expression with its first terms, and how many more there are."""
    parts = expression.replace(" - ", " + -").split(" + ")
    if len(parts) <= terms:
        return expression
    return (
        " + ".join(parts[:terms]).replace("+ -", "- ")
        + f" and {len(parts) - terms} more terms"
    )
