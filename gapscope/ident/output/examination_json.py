"""What recordings determine of the parameters, as plain data for ``identification.json``."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.ident.model.essential import EssentialParameters
from gapscope.ident.uncertainty.examination import Examination
from gapscope.ident.uncertainty.identifiability import CONDITION_LIMIT
from gapscope.ident.uncertainty.repeated_groups import GroupComparison
from gapscope.ident.uncertainty.torque_interval import PredictedTorque


def examined_document(
    examined: Examination, predicted: PredictedTorque | None
) -> dict[str, Any]:
    """The sections ``samples``, ``identifiability``, ``essential``, ``repeated_groups`` and ``torque_interval``."""
    shown, counted = examined.shown, examined.counted
    return {
        "samples": {
            "seconds": counted.seconds,
            "bandwidth": counted.bandwidth,
            "independent": counted.independent,
            "per_parameter": counted.per_parameter,
        },
        "identifiability": {
            "structural": shown.base.count,
            "rank": shown.rank,
            "condition": shown.condition,
            "condition_limit": CONDITION_LIMIT,
            "singular_values": shown.singular_values,
            "weakest": list(shown.weakest),
            "column_norms": dict(
                zip(shown.base.names, shown.column_norms, strict=True)
            ),
        },
        "essential": None
        if examined.essential is None
        else _essential(examined.essential),
        "repeated_groups": None
        if examined.groups is None
        else _groups(examined.groups),
        "torque_interval": None
        if predicted is None
        else _interval(examined, predicted),
        "not_examined": list(examined.reasons),
    }


def _essential(essential: EssentialParameters) -> dict[str, Any]:
    before, after = essential.residual
    return {
        "names": list(essential.names),
        "relative_std": essential.relative_deviation,
        "dropped": [
            {
                "name": d.name,
                "relative_std": d.relative_deviation,
                "contribution": d.contribution,
            }
            for d in essential.dropped
        ],
        "residual_growth": after / max(before, 1e-300) - 1,
    }


def _groups(groups: GroupComparison) -> dict[str, Any]:
    return {
        "count": len(groups.values),
        "stated_std": np.sqrt(groups.stated),
        "std_between": np.sqrt(groups.between),
        "ratio": groups.ratio,
        "p_value": groups.p_value,
        "verdict": groups.verdict,
        "meaning": _meaning(groups),
    }


def _meaning(groups: GroupComparison) -> str:
    if not groups.warnings:
        return "variance, not bias: they differ as much as the errors that they state"
    return groups.warnings[0]


def _interval(examined: Examination, predicted: PredictedTorque) -> dict[str, Any]:
    assert examined.interval is not None
    error = examined.interval.error
    return {
        "level": predicted.level,
        "half_width": predicted.half_width,
        "half_width_recorded": predicted.recorded,
        "held": predicted.held,
        "model_error": error.systematic,
        "noise": error.noise,
        "p_value": error.p_value,
        "joints_with_model_error": error.found,
    }
