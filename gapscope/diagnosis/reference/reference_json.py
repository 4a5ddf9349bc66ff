"""The part of ``diagnosis.json`` that states what the case was compared with, and its effect on the values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gapscope.diagnosis.reference.change import Change
from gapscope.diagnosis.reference.reference import names_of
from gapscope.diagnosis.reference.reference_uncertainty import EffectColumns
from gapscope.diagnosis.thresholds import FRICTION_DAY_TO_DAY

SCALED = (
    "masses are measured with the torque of the reference: were its torque constants wrong by a factor on all joints, "
    "the identified masses and the load found would be wrong by the same factor"
)
"""Warning given with each load found."""


def comparison_entry(
    change: Change, covariances: Sequence[tuple[EffectColumns, np.ndarray]]
) -> dict[str, Any]:
    """The document of the diagnosis with the key ``against``, wider deviations, and what must be said with it.

    Args:
        change: what changed.
        covariances: of each term's factors, what the reference leaves open included.
    """
    content = dict(change.diagnosis.document)
    content["effects"] = [
        _widened(effect, covariances) for effect in content["effects"]
    ]
    content["against"] = _against(change)
    notes = [f"reference: {text}" for text in change.reference.result.warnings]
    if any(
        effect["effect"] in ("payload", "link_inertia") for effect in content["effects"]
    ):
        notes.append(SCALED)
    content["warnings"] = [*content.get("warnings", []), *notes]
    return content


def _against(change: Change) -> dict[str, Any]:
    """What was identified on the reference, per joint, and what was allowed for on the day of the case."""
    reference, result = change.reference, change.reference.result
    places = names_of(result, ("I", "c", "b"))

    def of_value(value: np.ndarray) -> dict[str, Any]:
        names = ("armature", "coulomb", "viscous")
        return dict(zip(names, value[places].tolist(), strict=True))

    deviation = np.sqrt(np.diag(_inverse(reference.precision)))
    return {
        "reference": reference.case.name,
        "recordings": [r.name for r in reference.case.recordings],
        "identified": of_value(reference.value),
        "identified_std": of_value(deviation),
        "friction_law": str(result.choice.law),
        "base_parameters": result.base.count,
        "torque_ratio_to_nominal": reference.torque_ratio,
        "sampling_skew": reference.skew,
        "held_out": {
            "rmse": reference.rest.tolist(),
            "torque_nrmse": (reference.rest / reference.scale).tolist(),
        },
        "inherent": [_plain(effect) for effect in change.baseline.effects],
        "today": {
            **of_value(change.today.physical.value),
            "torque_nrmse": change.shift.tolist(),
            "friction_allowed": FRICTION_DAY_TO_DAY,
            "left_open": [
                {"effect": term.effect, "joint": term.joint, "closes": closes}
                for term, closes in change.left_open
            ],
        },
    }


def _plain(effect: Any) -> dict[str, Any]:
    values = {name: value.tolist() for name, value in effect.parameters.items()}
    return {"effect": effect.name, "joints": list(effect.joints), "parameters": values}


def _widened(
    effect: dict[str, Any], covariances: Sequence[tuple[EffectColumns, np.ndarray]]
) -> dict[str, Any]:
    """A finding whose standard deviations include the reference uncertainty, if its parameters allow."""
    by_joint = {t.joint: c for t, c in covariances if t.effect == effect["effect"]}
    parameters = dict(effect["parameters"])
    if effect["effect"] == "payload" and by_joint:
        covariance = by_joint[0]
        mass = np.asarray(parameters["mass"]["value"], dtype=float)
        com = np.asarray(parameters["com"]["value"], dtype=float)
        # c = h / m, so that dc = (dh - c dm) / m
        slope = np.concatenate([-com[:, None], np.eye(3)], axis=1) / mass
        com_std = np.sqrt(np.diag(slope @ covariance @ slope.T))
        mass_std = float(np.sqrt(covariance[0, 0]))
        parameters["mass"] = _with(parameters["mass"], mass_std)
        parameters["com"] = _with(parameters["com"], com_std)
    # faults of the set-up, such as wrong time stamps, name no joint and keep their values
    elif (
        len(parameters) == 1
        and effect["joints"]
        and set(effect["joints"]) <= set(by_joint)
    ):
        (name,) = parameters
        factors = [np.sqrt(by_joint[joint][0, 0]) for joint in effect["joints"]]
        values = np.abs(np.asarray(parameters[name]["value"], dtype=float))
        parameters[name] = _with(parameters[name], values * np.array(factors))
    return {**effect, "parameters": parameters}


def _with(parameter: dict[str, Any], more: Any) -> dict[str, Any]:
    """A parameter with the larger of its deviation and another."""
    std = np.maximum(np.asarray(parameter["std"] or 0.0, dtype=float), more)
    return {**parameter, "std": std.tolist()}


def _inverse(precision: np.ndarray) -> np.ndarray:
    """Inverse, scaled to a diagonal of ones first."""
    unit = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * unit[:, None] * unit
    return np.asarray(np.linalg.inv(scaled) * unit[:, None] * unit)
