"""The document of an agreement, ``agreement.json``."""

from __future__ import annotations

from typing import Any

from gapscope.arm.io.json_file import plain
from gapscope.diagnosis.agreement.agreement import (
    DIFFERS,
    Agreement,
    ParameterAgreement,
)
from gapscope.diagnosis.agreement.wording import goes_with, settles
from gapscope.diagnosis.thresholds import FALSE_ALARM_RATE, NAMED_PROBABILITY


def document(found: Agreement) -> dict[str, Any]:
    """An agreement as plain data; numbers that are not known are null.

    ``parameters`` has one entry per parameter, what differs first. ``values``, ``std`` and ``information`` have one
    number per recording, in the order of ``recordings``. ``covariates`` are those of the recordings as that parameter
    sees them.
    """
    content = {
        "schema": 1,
        "case": found.case.name,
        "joints": list(found.case.arm.joints),
        "recordings": list(found.labels),
        "friction_law": "Coulomb and viscous friction",
        "false_alarm_rate": FALSE_ALARM_RATE,
        "level": 1.0 - NAMED_PROBABILITY,
        "parameters": [_parameter(line, found) for line in found.parameters],
        "unknown": [
            {"joint": joint, "recording": found.labels[number]}
            for joint, number in found.unknown
        ],
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def states(found: Agreement) -> dict[str, Any]:
    """Whether recordings share a state, and what differs, as an entry of ``diagnosis.json``."""
    differing = found.having(DIFFERS)
    content = {
        "shared": not differing,
        "recordings": list(found.labels),
        "differs": [
            {
                "name": line.quantity.name,
                "unit": line.quantity.unit,
                "joints": [] if line.quantity.joint is None else [line.quantity.joint],
                "probability": 1.0 - (line.p or 0.0),
                "values": line.values.value,
                "std": line.values.std,
                "parameters": _per_recording(line),
            }
            for line in differing
        ],
        "command": f"gapscope agree {found.case.name}",
        "diagnosed": [found.labels[k] for k in found.states[0]],
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def _per_recording(line: ParameterAgreement) -> list[dict[str, Any]]:
    """Parameters of the effect in each recording."""
    return [
        {name: value.tolist() for name, value in each.items()}
        for each in line.values.parameters
    ]


def _parameter(line: ParameterAgreement, found: Agreement) -> dict[str, Any]:
    """One parameter."""
    trusted = line.trusted
    names = {one.quantity.key: one.quantity.name for one in found.parameters}
    return {
        "key": line.quantity.key,
        "name": line.quantity.name,
        "unit": line.quantity.unit,
        "joint": line.quantity.joint,
        "verdict": line.verdict,
        "p": line.p,
        "values": line.values.value,
        "parameters": _per_recording(line),
        "std": line.values.std,
        "information": line.information,
        "birge": line.birge,
        "trusted": None
        if trusted is None
        else {"value": trusted[0], "std": trusted[1]},
        "goes_with": None if line.explanation is None else _explanation(line, found),
        "settled_by": settles(line, found.labels) or None,
        "alternatives": [names[key] for key in line.alternatives],
        "covariates": {
            one.name: {"unit": one.unit, "values": one.value} for one in line.covariates
        },
    }


def _explanation(line: ParameterAgreement, found: Agreement) -> dict[str, Any]:
    """What a difference goes with."""
    explanation = line.explanation
    assert explanation is not None
    alone = explanation.alone
    return {
        "text": goes_with(line, found.labels),
        "covariates": list(explanation.goes_with),
        "recording": None if alone is None else found.labels[alone],
        "shares": explanation.shares,
        "differ": list(explanation.changed),
    }
