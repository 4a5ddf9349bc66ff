"""The document of an identification, ``identification.json``: checked against its schema and written whole."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import plain, write_json
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import arm_entry
from gapscope.ident.checks.table_row import Row
from gapscope.ident.estimators.by_name import method
from gapscope.ident.identification import Identification
from gapscope.ident.model.law_choice import STRONGEST
from gapscope.ident.model.physical_parameters import LinkCheck
from gapscope.ident.output.examination_json import examined_document
from gapscope.ident.output.filter_json import filter_document, states_document
from gapscope.ident.uncertainty.validation import LEVEL, MOVING, Errors, Validation
from gapscope.model.change_findings import change_findings


def document(
    result: Identification, files: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """What was identified, as plain data in the form of ``identification.schema.json``.

    Args:
        result: what was identified.
        files: what was written beside it, by purpose.
    """
    arm = result.case.arm
    return {
        "schema": 1,
        "case": result.case.name,
        "arm": arm_entry(arm),
        "settings": _settings(result),
        "base": _base(result),
        **examined_document(result.examined, result.predicted),
        "changes": [_change(entry) for entry in change_findings(result.changes)],
        "filter": filter_document(result.filtered, result.base.expressions(1e-4)),
        "states_and_friction": states_document(result.states),
        "parameters": [
            {
                "name": r.name,
                "unit": r.unit,
                "status": r.status,
                "reason": r.reason,
                "nominal": r.nominal,
                "value": r.value,
                "std": r.deviation,
            }
            for r in result.recovered
        ],
        "links": [
            _link(b, a)
            for b, a in zip(result.physical.before, result.physical.after, strict=True)
        ],
        "joint_zeros": {
            "unit": common_unit("rad", arm.sliding),
            "offset": result.zeros.offset,
            "std": result.zeros.deviation,
            "known": result.zeros.known,
            "asked": result.zeros.asked + 1,
        },
        "validation": [_validation(v) for v in result.validation],
        "troubleshooting": [_row(row) for row in result.table],
        "questions": list(result.questions),
        "warnings": list(result.warnings),
        "files": dict(files or {}),
    }


def _settings(result: Identification) -> dict[str, Any]:
    """What was asked for, and the friction law and pull that were chosen."""
    choice, settings = result.choice, result.settings
    law = choice.law
    return {
        "cutoff": settings.cutoff,
        "estimator": settings.estimator,
        "trimmed": settings.trim,
        "moving": MOVING,
        "friction": str(law),
        "stribeck_speed": law.stribeck_speed,
        "saturation_speeds": law.saturation_speeds,
        "presliding": law.presliding,
        "pull": choice.pull,
        "strongest_pull": choice.pull >= STRONGEST,
        "tried": [
            {"what": what, "unseen_error": error} for what, error in choice.tried
        ],
    }


def _base(result: Identification) -> dict[str, Any]:
    base, value = result.base, result.estimate.value
    low, high = result.uncertainty.interval(value)
    nominal = base.of(result.columns.nominal(result.choice.law))
    bodies = base.of(result.physical.value)
    expressions = base.expressions(1e-4)
    moved = result.moved
    entries = zip(
        expressions,
        value,
        result.uncertainty.deviation,
        low,
        high,
        bodies,
        nominal,
        np.ones(base.count, dtype=bool) if moved is None else moved,
        strict=True,
    )
    return {
        "count": base.count,
        "condition": result.condition,
        "interval": method(result.settings.estimator).kind,
        "freedom": result.uncertainty.freedom,
        "parameters": [
            {
                "expression": e,
                "value": v,
                "std": s,
                "interval": [a, b],
                "consistent": c,
                "nominal": x,
                **({} if moved is None else {"moved": bool(m)}),
            }
            for e, v, s, a, b, c, x, m in entries
        ],
    }


def _change(entry: dict[str, Any]) -> dict[str, Any]:
    """A finding of ``change_findings`` with its parameters side by side."""
    names = list(entry["parameters"])
    values, deviations = (
        np.hstack([part[key] for part in entry["parameters"].values()])
        for key in ("value", "std")
    )
    return {
        **{key: x for key, x in entry.items() if key != "times_threshold"},
        "parameters": names,
        "size": values,
        "std": deviations,
        "statistic": entry["times_threshold"],
    }


def _link(before: LinkCheck, after: LinkCheck) -> dict[str, Any]:
    return {
        "link": after.link,
        "mass": after.mass,
        "principal_moments": after.moments,
        "positive_mass": after.positive_mass,
        "positive_inertia": after.positive_inertia,
        "triangle": after.triangle,
        "pseudo_inertia": after.consistent,
        "unconstrained": {"mass": before.mass, "consistent": before.consistent},
    }


def _validation(validation: Validation) -> dict[str, Any]:
    white = validation.whiteness
    return {
        "role": validation.role,
        "recordings": list(validation.recordings),
        "every": _errors(validation.every),
        "moving": _errors(validation.moving),
        "nominal": _errors(validation.nominal),
        "whiteness": {
            "ljung_box": white.statistic,
            "p_value": white.p_value,
            "level": LEVEL,
            "white": white.white,
            "largest_autocorrelation": white.largest,
            "bound": white.bound,
        },
    }


def _errors(errors: Errors) -> dict[str, Any]:
    return {
        "rmse": errors.rmse,
        "relative": errors.relative,
        "largest": errors.largest,
        "overall": errors.overall,
        "share": errors.share,
    }


def _row(row: Row) -> dict[str, Any]:
    entry = row.entry
    return {
        "key": entry.key,
        "symptom": entry.symptom,
        "cause": entry.cause,
        "check": entry.check,
        "remedy": entry.remedy,
        "measured": row.measured,
        "threshold": row.threshold,
        "unit": row.unit,
        "verdict": row.verdict,
        "joints": list(row.joints),
    }


@cache
def _validator() -> Any:
    from jsonschema import Draft202012Validator

    text = (
        resources.files("gapscope.ident.output")
        .joinpath("identification.schema.json")
        .read_text(encoding="utf-8")
    )
    return Draft202012Validator(json.loads(text))


def check(content: Mapping[str, Any]) -> None:
    """Check a plain document against ``identification.schema.json``.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    from jsonschema.exceptions import best_match

    error = best_match(_validator().iter_errors(content))
    if error is not None:
        raise GapscopeError(
            f"identification.json, field {_field(error.absolute_path)}: {error.message}",
            "gapscope/ident/output/identification.schema.json describes the format",
        )


def _field(path: Sequence[Any]) -> str:
    return (
        "".join(
            f"[{step}]" if isinstance(step, int) else f".{step}" for step in path
        ).lstrip(".")
        or "at the top"
    )


def write_document(content: Mapping[str, Any], path: Path | str) -> None:
    """Write a document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    found = plain(content, null_if_not_finite=True)
    check(found)
    write_json(found, path)
