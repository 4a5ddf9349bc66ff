"""What the figures draw: torque over time and the residual over speed, as base64 of float32."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from gapscope.ident.identification import Identification
from gapscope.ident.uncertainty.identifiability import CONDITION_LIMIT
from gapscope.ident.uncertainty.validation import Validation
from gapscope.reports.diagnosis.figures import encode, keep_extremes
from gapscope.reports.identification.filter_section import filter_curves

POINTS = 3000
"""Most points of one curve over time."""
DOTS = 1200
"""Most points of one cloud."""
FLOOR = 1e-8
"""Where the spectrum ends at the bottom [1]."""


def payload(result: Identification) -> dict[str, Any]:
    """All that the script of the report draws, as JSON-ready values."""
    names = result.case.arm.joints
    judged = result.validation[1]
    worst = int(np.nanargmax(judged.every.relative))
    groups = [
        _group(validation, a, b, k)
        for validation in result.validation[::-1]
        for k, (a, b) in _spans(validation)
    ]
    return {
        "joints": [f"J{j + 1} {name}" for j, name in enumerate(names)],
        "worst": worst,
        "slides": list(result.case.arm.sliding),
        "groups": groups,
        "spectrum": [
            float(x) for x in np.maximum(result.examined.shown.singular_values, FLOOR)
        ],
        "limit": 1 / CONDITION_LIMIT,
        "filter": filter_curves(result),
    }


def _spans(validation: Validation) -> list[tuple[int, tuple[int, int]]]:
    return list(enumerate(pairwise(validation.edges), 1))


def _group(validation: Validation, a: int, b: int, number: int) -> dict[str, Any]:
    """One segment: per joint the curves over time, and the residual over the speed."""
    joints = []
    t = validation.t[a:b]
    for j in range(validation.torque.shape[1]):
        torque, predicted, before, speed = (
            x[a:b, j]
            for x in (
                validation.torque,
                validation.predicted,
                validation.before,
                validation.velocity,
            )
        )
        keep = keep_extremes([torque, torque - predicted], POINTS)
        dots = np.unique(np.linspace(0, b - a - 1, min(b - a, DOTS)).astype(int))
        joints.append(
            {
                "t": encode(t[keep]),
                "recorded": encode(torque[keep]),
                "identified": encode(predicted[keep]),
                "nominal": encode(before[keep]),
                "speed": encode(speed[dots]),
                "left": encode((torque - predicted)[dots]),
            }
        )
    role = {"fit": "fitted", "judge": "unseen"}[validation.role]
    names = ", ".join(validation.recordings)
    return {
        "name": f"{names}, part {number} ({role})"
        if len(validation.edges) > 2
        else f"{names} ({role})",
        "joints": joints,
    }
