"""The part of ``diagnosis.json`` that states what the case was compared with, and its effect on the values."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.diagnosis.model.nuisance_prior import inverse
from gapscope.diagnosis.reference.change import Change
from gapscope.diagnosis.thresholds import FRICTION_DAY_TO_DAY
from gapscope.effects.catalogue import known_effect
from gapscope.effects.effect import SHEET, LinkChange

SCALED = (
    "masses are measured with the torque of the reference: were its torque constants wrong by a factor on all joints, "
    "the identified masses and the load found would be wrong by the same factor"
)
"""Warning given with each load found."""


def comparison_entry(change: Change) -> dict[str, Any]:
    """The document of the diagnosis with the key ``against``, and what must be said with it."""
    content = dict(change.diagnosis.document)
    content["against"] = _against(change)
    notes = [f"reference: {text}" for text in change.reference.warnings]
    named = [known_effect(effect["effect"]) for effect in content["effects"]]
    if any(isinstance(effect, LinkChange) for effect in named):
        notes.append(SCALED)
    content["warnings"] = [*content.get("warnings", []), *notes]
    return content


def _against(change: Change) -> dict[str, Any]:
    """What was identified on the reference, per joint, and what was allowed for on the day of the case."""
    reference = change.reference
    places = reference.places(("I", "c", "b"))

    def of_value(value: np.ndarray) -> dict[str, Any]:
        names = (SHEET["rotor"], SHEET["friction"], SHEET["damping"])
        return dict(zip(names, value[places].tolist(), strict=True))

    deviation = np.sqrt(np.diag(inverse(reference.precision)))
    today = reference.value + change.error
    return {
        "reference": reference.name,
        "recordings": list(reference.recordings),
        "made_from": dict(reference.made_from),
        "identified": of_value(reference.value),
        "identified_std": of_value(deviation),
        "friction_law": str(reference.law),
        "base_parameters": reference.base_parameters,
        "torque_ratio_to_nominal": reference.torque_ratio,
        "sampling_skew": reference.skew,
        "held_out": {
            "rmse": reference.rest.tolist(),
            "torque_nrmse": (reference.rest / reference.scale).tolist(),
        },
        "inherent": [_plain(effect) for effect in change.baseline.effects],
        "today": {
            **of_value(today),
            "torque_nrmse": change.shift.tolist(),
            "friction_allowed": FRICTION_DAY_TO_DAY,
        },
    }


def _plain(effect: Any) -> dict[str, Any]:
    values = {name: value.tolist() for name, value in effect.parameters.items()}
    return {"effect": effect.name, "joints": list(effect.joints), "parameters": values}
