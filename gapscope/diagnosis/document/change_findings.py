"""Findings on what changed during a recording, as ``diagnosis.json`` holds them and in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gapscope.diagnosis.display import uncertain
from gapscope.ident.kalman.change_hypothesis import PAYLOAD
from gapscope.ident.kalman.changes import RecordingChange

PARAMETERS = {
    "m": ("mass", "kg"),
    "mx": ("first_moment_x", "kg m"),
    "my": ("first_moment_y", "kg m"),
    "mz": ("first_moment_z", "kg m"),
    "b": ("viscous", "N m s/rad"),
    "c": ("coulomb", "N m"),
}
"""Name and unit of a parameter, by its symbol."""


def change_finding(found: RecordingChange) -> dict[str, Any]:
    """An entry of ``changes``: what changed, in which recording, when, by how much."""
    change = found.change
    parameters = {}
    entries = zip(change.hypothesis.names, change.size, change.deviation, strict=True)
    for symbol, size, deviation in entries:
        name, unit = PARAMETERS[symbol.rstrip("0123456789")]
        parameters[name] = {"unit": unit, "value": float(size), "std": float(deviation)}
    payload = change.hypothesis.name == PAYLOAD
    joint = [] if payload else [_joint(change.hypothesis.names[0])]
    return {
        "recording": found.recording,
        "what": PAYLOAD if payload else "friction",
        "joints": joint,
        "time": change.time,
        "interval": list(change.interval),
        "parameters": parameters,
        "times_threshold": change.statistic,
    }


def change_text(entry: Mapping[str, Any]) -> str:
    """A finding in words: ``load of 1.50 ± 0.01 kg picked up at 3.70 s of recording_1.csv``."""
    when = f"at {entry['time']:.2f} s of {entry['recording']}"
    if entry["what"] == PAYLOAD:
        mass = entry["parameters"]["mass"]
        done = "picked up" if mass["value"] > 0 else "put down"
        size = f"{uncertain(abs(mass['value']), mass['std'])} kg"
        return f"load of {size} {done} {when}"
    sizes = [
        f"{name} by {uncertain(part['value'], part['std'])} {part['unit']}"
        for name, part in entry["parameters"].items()
    ]
    (joint,) = entry["joints"]
    return f"friction of joint {joint} changed {when}: {', '.join(sizes)}"


def _joint(symbol: str) -> int:
    """Joint of a parameter such as ``b3``."""
    return int(symbol.lstrip("abcdefghijklmnopqrstuvwxyz"))
