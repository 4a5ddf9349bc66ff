"""The document of an identification, with what was examined and filtered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import field, plain, schema_fault, write_json
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import arm_entry
from gapscope.ident.checks.troubleshooting import Row
from gapscope.ident.estimators.by_name import method
from gapscope.ident.identification import Identification
from gapscope.ident.kalman.filters import StatesAndFriction
from gapscope.ident.kalman.review import Departure, FilterReview
from gapscope.ident.model.base_parameters import EssentialParameters, orthonormal_base
from gapscope.ident.model.friction import STRONGEST
from gapscope.ident.model.physical_parameters import LinkCheck
from gapscope.ident.uncertainty.examination import (
    CONDITION_LIMIT,
    LEVEL,
    MOVING,
    Errors,
    Examination,
    Validation,
)
from gapscope.ident.uncertainty.intervals import GroupComparison, PredictedTorque
from gapscope.model.change_findings import change_findings

# The base parameters as matrices, both ways: ``base_parameters.npz``.


def write_base(result: Identification, path: Path | str) -> None:
    """Write the base parameters of an identification as arrays; ``path`` never holds half a file.

    ``names`` and ``kept_names`` of the p parameters pi and of the b that represent combinations; ``combination`` C
    with beta = C pi, shape (b, p); ``back`` and ``null_space`` N with pi = back beta + N z for any z, shapes (p, b)
    and (p, p - b); ``value`` and ``covariance`` of beta, ``consistent`` and ``nominal`` pi. ``orthonormal`` V with
    gamma = V^T pi and the shortest pi = V gamma, shape (p, b), by singular value decomposition; ``from_orthonormal``
    and ``to_orthonormal`` T with beta = T gamma and gamma = T beta, shape (b, b).

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    base, names = result.base, result.base.names
    # C has full rank, so that its rows, padded to p, have the row space of the samples and no weak direction of theirs
    padding = np.zeros((len(names) - base.count, len(names)))
    other = orthonormal_base(np.vstack([base.combination, padding]), names)
    back = np.zeros((len(names), base.count))
    back[base.kept] = np.eye(base.count)
    arrays = {
        "names": np.array(names),
        "kept_names": np.array([names[k] for k in base.kept]),
        "combination": base.combination,
        "back": back,
        "null_space": base.null_space,
        "value": result.estimate.value,
        "covariance": result.uncertainty.covariance,
        "consistent": result.physical.value,
        "nominal": result.columns.nominal(result.choice.law),
        "orthonormal": other.basis,
        "from_orthonormal": other.to_base(base),
        "to_orthonormal": other.from_base(base),
    }
    with atomic_write(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


# What recordings determine of the parameters, as plain data for ``identification.json``.


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


# The filter beside the batch, as ``identification.json`` holds it.


MOMENTS = 60
"""Moments at which the estimates are written, at most."""


def filter_document(review: FilterReview, expressions: Sequence[str]) -> dict[str, Any]:
    """Estimates over time with standard deviations, innovations, convergence, departures.

    Args:
        review: of the filter.
        expressions: the base parameters in words, shape (b,).
    """
    followed, white = review.followed, review.whiteness
    track, count = followed.track, len(review.times)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    value, deviation = track.value[chosen], track.deviation[chosen]
    start = review.converged
    return {
        "process_noise": followed.level,
        "stretch": followed.stretches.length,
        "converged": None if start is None else review.elapsed[start],
        "elapsed": review.elapsed[chosen],
        "recordings": _recordings(review),
        "parameters": [
            {
                "expression": expression,
                "batch": review.batch[i],
                "value": _rounded(value[:, i]),
                "std": _rounded(deviation[:, i]),
            }
            for i, expression in enumerate(expressions)
        ],
        "innovations": {
            "rms": review.rms,
            "samples_per_independent": followed.inflation,
            "ljung_box": white.statistic,
            "p_value": white.p_value,
            "level": LEVEL,
            "white": white.white,
            "largest_autocorrelation": white.largest,
            "bound": white.bound,
        },
        "departures": [
            _departure(review, departure, expressions)
            for departure in review.departures
        ],
    }


def states_document(states: StatesAndFriction | None) -> dict[str, Any] | None:
    """Friction by the unscented filter over time, and how well it predicts the encoders; ``None`` if not asked for."""
    if states is None:
        return None
    track = states.track
    count = len(track.t)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    value, deviation = states.friction[chosen], states.deviation[chosen]
    return {
        "recording": states.recording,
        "time": track.t[chosen],
        "innovation_rms": np.sqrt(np.mean(track.innovation[1:] ** 2, axis=0)),
        "parameters": [
            {
                "name": name,
                "identified": states.start[i],
                "value": _rounded(value[:, i]),
                "std": _rounded(deviation[:, i]),
            }
            for i, name in enumerate(states.names)
        ],
    }


def _recordings(review: FilterReview) -> list[dict[str, Any]]:
    """The recordings in the order of the filter, each with its end."""
    stretches = zip(review.recordings, review.elapsed, strict=True)
    runs = groupby(stretches, key=lambda stretch: stretch[0])
    return [{"name": name, "until": list(run)[-1][1]} for name, run in runs]


def _departure(
    review: FilterReview, departure: Departure, expressions: Sequence[str]
) -> dict[str, Any]:
    k, i = departure.stretch, departure.parameter
    track = review.followed.track
    return {
        "expression": expressions[i],
        "recording": review.recordings[k],
        "time": review.times[k],
        "elapsed": review.elapsed[k],
        "filter": track.value[k, i],
        "std": track.deviation[k, i],
        "batch": review.batch[i],
        "standard_errors": departure.size,
    }


def _rounded(series: np.ndarray) -> list[float]:
    """Five significant digits, which keeps the file small."""
    return [float(f"{x:.5g}") for x in series]


# The document of an identification, ``identification.json``: checked against its schema and written whole.


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


def check(content: Mapping[str, Any]) -> None:
    """Check a plain document against ``identification.schema.json``.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    error = schema_fault(content, "identification")
    if error is not None:
        raise GapscopeError(
            f"identification.json, field {field(error.absolute_path) or 'at the top'}: {error.message}",
            "gapscope/schemas/identification.schema.json describes the format",
        )


def write_document(content: Mapping[str, Any], path: Path | str) -> None:
    """Write a document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    found = plain(content, null_if_not_finite=True)
    check(found)
    write_json(found, path)
