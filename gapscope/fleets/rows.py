"""What is kept of a diagnosis: a row for the case, and a row for each number of each effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

UNKNOWN = "unknown"
"""Robot of a case that cannot be read."""
INTERVAL = 1.96
"""Standard deviations to each side of an interval of 95 %, for normal errors [1]."""

_TIME = pa.timestamp("us", tz="UTC")
_COMMON = {
    "result": pa.string(),
    "case": pa.string(),
    "unit": pa.string(),
    "robot": pa.string(),
    "date": pa.string(),
}
CASES = pa.schema(
    {
        **_COMMON,
        "name": pa.string(),
        "recorded_at": pa.timestamp("s"),
        "joints": pa.list_(pa.string()),
        "finished": _TIME,
        "fingerprint": pa.string(),
        "case_sha256": pa.string(),
        "program_sha256": pa.string(),
        "nominal_sha256": pa.string(),
        "verdict": pa.string(),
        "gap": pa.float64(),
        "excess": pa.float64(),
        "left": pa.float64(),
        "closed": pa.float64(),
        "effects": pa.list_(pa.string()),
        "recorded_seconds": pa.float64(),
        "bytes": pa.int64(),
        "seconds": pa.float64(),
        "processor_seconds": pa.float64(),
        "tries": pa.int32(),
        "error": pa.string(),
        "kept": pa.string(),
    }
)
"""A row for each case; ``docs/fleet.md`` says what the columns mean."""
EFFECTS = pa.schema(
    {
        **_COMMON,
        "nominal_sha256": pa.string(),
        "named": pa.bool_(),
        "effect": pa.string(),
        "joint": pa.int32(),
        "link": pa.int32(),
        "parameter": pa.string(),
        "component": pa.string(),
        "si_unit": pa.string(),
        "value": pa.float64(),
        "std": pa.float64(),
        "low": pa.float64(),
        "high": pa.float64(),
        "probability": pa.float64(),
        "share": pa.float64(),
    }
)
"""A row for each number of an effect on one joint, link or the arm; one without number for an effect that has none."""
PLACE = ["effect", "joint", "link"]
NUMBER = [*PLACE, "parameter", "component"]

Document = Mapping[str, Any]


def gap_columns(document: Document) -> dict[str, Any]:
    """What the row of a case says of its gap; means over the joints of torque NRMSE [1].

    ``gap`` before any effect, ``excess`` of it over the floor, ``left`` of that after the effects.
    """
    floor = _numbers(document["gap"]["before"]["floor"])
    before = _numbers(document["gap"]["before"]["torque_nrmse"])
    after = _numbers(document["gap"]["after"]["torque_nrmse"])
    return {
        "verdict": document["verdict"],
        "gap": _mean(before),
        "excess": _mean(np.maximum(before - floor, 0.0)),
        "left": _mean(np.maximum(after - floor, 0.0)),
        "closed": document["closed"],
        "effects": [entry["effect"] for entry in document["effects"]],
        "recorded_seconds": sum(r["duration"] for r in document["recordings"]),
    }


def effect_rows(document: Document) -> Iterator[dict[str, Any]]:
    """The numbers of all effects, named or possible."""
    for section in ("effects", "possible"):
        for entry in document[section]:
            common = {
                "named": section == "effects",
                "effect": entry["effect"],
                "link": _link(entry),
                "probability": entry["probability"],
                "share": entry["share"],
            }
            for number in _entry_rows(entry):
                yield {**common, **number}


def _entry_rows(entry: Document) -> Iterator[dict[str, Any]]:
    names = [name for name in entry["parameters"] if name != "link"]
    if not names:  # a fault of the set-up that is there or not
        for joint in entry["joints"] or [None]:
            yield {"joint": joint, "parameter": "", "component": "", "si_unit": ""}
    for name in names:
        yield from _parameter_rows(name, entry["parameters"][name], entry["joints"])


def _parameter_rows(
    name: str, parameter: Document, joints: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """A row for each joint, or each component of a vector."""
    values = _numbers(parameter["value"])
    stds = np.broadcast_to(_numbers(parameter["std"]), values.shape)
    units = parameter.get("units") or [parameter["unit"]] * len(values)
    vector = not joints and len(values) == 3
    for k, (value, std) in enumerate(zip(values, stds, strict=True)):
        known = bool(np.isfinite(std))
        yield {
            "joint": joints[k] if joints else None,
            "parameter": name,
            "component": "xyz"[k] if vector else "",
            "si_unit": units[k],
            "value": float(value),
            "std": float(std) if known else None,
            "low": float(value - INTERVAL * std) if known else None,
            "high": float(value + INTERVAL * std) if known else None,
        }


def _link(entry: Document) -> int | None:
    link = entry["parameters"].get("link")
    return int(link["value"]) if link else None


def _numbers(values: Any) -> np.ndarray:
    """Numbers as an array, NaN for null."""
    return np.atleast_1d(np.array(values, dtype=float))


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None
