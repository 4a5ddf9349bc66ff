"""Findings on what changed during a recording, as ``diagnosis.json`` holds them and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gapscope.arm.display import effect_name, uncertain
from gapscope.effects.catalogue import of_quantity
from gapscope.model.changes import Change, when_text
from gapscope.model.terms import Term

PAYLOAD = of_quantity("load")[0].name
"""What a load on the last link is called, picked up or put down."""
LOAD = (
    ("mass", "kg"),
    ("first_moment_x", "kg m"),
    ("first_moment_y", "kg m"),
    ("first_moment_z", "kg m"),
)
"""Coordinates of a load that are told."""
FRICTION = {"damping": "viscous", "friction": "coulomb"}
"""Name of plain friction of a joint, by the quantity of the effect."""
PLAIN_FRICTION = "friction"


def change_findings(changes: Sequence[Change]) -> list[dict[str, Any]]:
    """Entries of ``changes``: what changed, in which recording, when, by how much."""
    out: list[dict[str, Any]] = []
    for entry in map(_finding, changes):
        twin = next((other for other in out if _are_one(entry, other)), None)
        if twin is None:
            out.append(entry)
            continue
        twin["parameters"] |= entry["parameters"]
        if np.ptp(entry["interval"]) < np.ptp(twin["interval"]):
            twin |= {key: entry[key] for key in ("time", "interval", "until")}
    return out


def _are_one(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether both are plain friction of a joint that changes at one moment."""
    same = all(one[key] == other[key] for key in ("recording", "what", "joints"))
    low = max(one["interval"][0], other["interval"][0])
    high = min(one["interval"][1], other["interval"][1])
    new = not set(one["parameters"]) & set(other["parameters"])
    return one["what"] == PLAIN_FRICTION and same and low <= high and new


def called(term: Term) -> tuple[str, tuple[int, ...]]:
    """What a change of a term is called, and on which joints: plain friction together, a load by one name."""
    what = PLAIN_FRICTION if _friction(term) else term.effect
    if term.is_load:
        what = PAYLOAD
    return what, (term.joint,) if term.joint else ()


def _finding(change: Change) -> dict[str, Any]:
    what, joints = called(change.term)
    return {
        "recording": change.recording,
        "what": what,
        "effect": change.term.effect,
        "joints": list(joints),
        "time": change.time,
        "interval": list(change.interval),
        "until": change.until,
        "parameters": _parameters(change),
        "probability": change.probability,
        "times_threshold": change.support,
    }


def _friction(term: Term) -> str | None:
    """Name of plain friction; ``None`` of anything else."""
    quantities = term.definition.quantities.values()
    return next((FRICTION[q] for q in quantities if q in FRICTION), None)


def _parameters(change: Change) -> dict[str, dict[str, Any]]:
    """By how much each parameter changed, with its standard deviation."""
    if change.term.is_load:
        names = list(LOAD)
    elif friction := _friction(change.term):
        names = [(friction, change.term.definition.parameters[0].unit)]
    else:
        return _of_effect(change)
    return {
        name: {"unit": unit, "value": float(value), "std": float(std)}
        for (name, unit), value, std in zip(
            names, change.value, change.deviation, strict=False
        )
    }


def _of_effect(change: Change) -> dict[str, dict[str, Any]]:
    """Parameters of an effect that a joint or the arm has from then on."""
    value, deviations = change.value, change.deviation
    middle = _values(change, value)
    # each coordinate by a deviation up, and down
    steps = [
        (_values(change, value + step), _values(change, value - step))
        for step in np.diag(deviations)
    ]
    out = {}
    times = change.term.parametrisation.nonlinear
    for parameter in change.term.definition.parameters:
        name = parameter.name
        # the number of a link is no value, and when a force acts is said already
        if name not in middle or name in times:
            continue
        half = [(up[name] - down[name]) / 2 for up, down in steps]
        std = np.sqrt((np.array(half) ** 2).sum(axis=0))
        unit = parameter.unit
        out[name] = {"unit": unit, "value": _plain(middle[name]), "std": _plain(std)}
    return out


def _values(change: Change, value: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters by the term's coordinates, (linear,)."""
    fitted = change.term.parametrisation
    searched = np.zeros((len(fitted.nonlinear), 1))
    given = fitted.values(value[:, None], searched)
    return {name: np.ravel(np.asarray(x, dtype=float)) for name, x in given.items()}


def _plain(values: np.ndarray) -> float | list[float]:
    return float(values[0]) if len(values) == 1 else values.tolist()


def change_text(entry: Mapping[str, Any]) -> str:
    """A finding in words: ``load of 1.50 ± 0.01 kg picked up at 3.70 s of recording_1.csv``."""
    # documents written before changes could take a while have none
    when = f"{when_text(entry['time'], entry.get('until'))} of {entry['recording']}"
    if entry["what"] == PAYLOAD:
        mass = entry["parameters"]["mass"]
        done = "picked up" if mass["value"] > 0 else "put down"
        size = f"{uncertain(abs(mass['value']), mass['std'])} kg"
        return f"load of {size} {done} {when}"
    sizes = []
    for name, part in entry["parameters"].items():
        values, stds = np.ravel(part["value"]), np.ravel(part["std"])
        each = [uncertain(*pair) for pair in zip(values, stds, strict=True)]
        size = each[0] if len(each) == 1 else f"({', '.join(each)})"
        sizes.append(f"{name} by {size} {part['unit']}".removesuffix(" 1"))
    plain = entry["what"] == PLAIN_FRICTION
    name = PLAIN_FRICTION if plain else effect_name(entry["what"])
    joints = entry["joints"]
    where = f" of joint {joints[0]}" if joints else ""
    return f"{name}{where} changed {when}: {', '.join(sizes)}"
