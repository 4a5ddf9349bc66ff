"""How large effects would have to be for recordings to show them, as documents have it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.selection.search import could_show
from gapscope.ident.excitation.design import Excitation
from gapscope.model.expected import Detectable


def planned_entries(
    arm: NominalArm, planned: Excitation, payload: KnownLoad | None = None
) -> list[dict[str, Any]]:
    """``expected`` of a motion that is only planned, of an arm that leaves no more than a healthy one of its kind.

    Args:
        arm: the nominal arm.
        planned: the motion with its nominal torque.
        payload: that it is made with, or ``None``.
    """
    motion = planned.motion
    recording = Recording(
        "planned", motion.t, motion.q, planned.torque, payload=payload
    )
    with threadpool_limits(1):
        return expected_entries(could_show(arm, [recording]))


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
