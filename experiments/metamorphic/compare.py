"""The diagnosis of a twin beside that of its case: names, values, shares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .relations import Twin

Document = Mapping[str, Any]
Key = tuple[str, str, int]
"""Effect, parameter, and joint from 1, or minus the place of a component."""

NO_SCATTER = 1e-3
"""Least standard deviation of a value in a comparison, over the value [1]: a step of an encoder has none."""


@dataclass(frozen=True)
class Difference:
    """What differs between a case and its twin.

    Attributes:
        verdict, named, possible: whether they are the same; effects with their joints.
        value: largest difference of a value of a named effect over its standard deviation [1].
        share: largest difference of a share [1].
        probability: largest difference of a probability [1].
        closed: difference of the closed share of the gap [1].
        nrmse: largest difference of a joint's torque NRMSE, before and after [1].
        floor: largest relative difference of a joint's floor over torque [1].
        words: both lists of effects, if they differ.
    """

    verdict: bool
    named: bool
    possible: bool
    value: float
    share: float
    probability: float
    closed: float
    nrmse: float
    floor: float
    words: str = ""

    @property
    def same_names(self) -> bool:
        """Whether verdict, effects and joints are the same, possible ones too."""
        return self.verdict and self.named and self.possible


def compare(case: Document, other: Document, twin: Twin) -> Difference:
    """Compare the diagnosis of a twin, in the joints and units of its case, with that of the case."""
    lists = [_effects(case, Twin(twin.files)), _effects(other, twin)]
    (named, possible), (named_too, possible_too) = lists
    same = case["verdict"] == other["verdict"]
    words = ""
    if not same or named != named_too or possible != possible_too:
        words = f"{_described(case, *lists[0])} -> {_described(other, *lists[1])}"
    before = _by_joint(case, Twin(twin.files))
    after = _by_joint(other, twin)
    return Difference(
        verdict=same,
        named=named == named_too,
        possible=possible == possible_too,
        value=_value_difference(case, other, twin),
        share=_entry_difference(case, other, "share"),
        probability=_entry_difference(case, other, "probability"),
        closed=abs((case["closed"] or 0.0) - (other["closed"] or 0.0)),
        nrmse=float(np.abs(before[:2] - after[:2]).max()),
        floor=float(np.abs(before[2] - after[2]).max()),
        words=words,
    )


def _effects(document: Document, twin: Twin) -> tuple[dict[str, Any], dict[str, Any]]:
    """Joints by the name of an effect, named and possible."""
    both = []
    for section in ("effects", "possible"):
        both.append(
            {
                entry["effect"]: sorted(twin.joints(entry["joints"]))
                for entry in document[section]
            }
        )
    return both[0], both[1]


def _described(
    document: Document, named: dict[str, Any], possible: dict[str, Any]
) -> str:
    """Verdict, effects with their joints, and possible ones in brackets."""
    parts = [f"{name} {joints}" for name, joints in named.items()]
    parts += [f"({name} {joints})" for name, joints in possible.items()]
    return f"{document['verdict']}: {', '.join(parts) or 'nothing'}"


def _by_joint(document: Document, twin: Twin) -> np.ndarray:
    """Torque NRMSE before and after, and the floor, in the order of the case's joints, (3, n)."""
    gap = document["gap"]
    rows = [gap["before"]["torque_nrmse"], gap["after"]["torque_nrmse"]]
    rows = np.array([*rows, gap["before"]["floor"]], dtype=float)
    places = np.array(twin.joints(list(range(1, rows.shape[1] + 1)))) - 1
    sorted_rows = np.empty_like(rows)
    sorted_rows[:, places] = rows
    return sorted_rows


def _entry_difference(case: Document, other: Document, key: str) -> float:
    """Largest difference of a number of the effects that both name."""
    entries = {entry["effect"]: entry for entry in other["effects"]}
    sizes = [0.0]
    for entry in case["effects"]:
        if entry["effect"] in entries:
            one, two = entry[key], entries[entry["effect"]][key]
            sizes.append(abs((one or 0.0) - (two or 0.0)))
    return max(sizes)


def _value_difference(case: Document, other: Document, twin: Twin) -> float:
    """Largest difference of a value that both name over its standard deviation."""
    ours, theirs = _values(case, Twin(twin.files)), _values(other, twin)
    sizes = [0.0]
    for key in ours.keys() & theirs.keys():
        one, two = ours[key], theirs[key]
        scatter = max(one[1], NO_SCATTER * abs(one[0]), 1e-12)
        difference = one[0] - two[0]
        if key[1] == "phase":
            difference = (difference + np.pi) % (2 * np.pi) - np.pi
        sizes.append(abs(difference) / scatter)
    return max(sizes)


def _values(document: Document, twin: Twin) -> dict[Key, tuple[float, float]]:
    """Values and standard deviations of the named effects, in the case's joints, units and base frame."""
    found = {}
    for entry in document["effects"]:
        effect, joints = entry["effect"], entry["joints"]
        for name, unit, values, deviations in _parameters(entry):
            at_joints = joints and len(joints) == len(values)
            places = twin.joints(joints) if at_joints else range(0, -len(values), -1)
            for place, x, std in zip(places, values, deviations, strict=True):
                of = (effect, name, unit, place)
                found[effect, name, place] = (twin.value(*of, x), std / twin.size(unit))
    if twin.turned:
        _turn_back(found, twin.turned)
    return found


def _parameters(entry: Document) -> Iterator[tuple[str, str, list[float], list[float]]]:
    """Name, unit, values and standard deviations of an effect's parameters that are numbers."""
    for name, parameter in entry["parameters"].items():
        values = np.atleast_1d(parameter["value"])
        if values.dtype.kind not in "if":
            continue
        deviations = np.zeros(len(values))
        if parameter.get("std") is not None:
            deviations = np.atleast_1d(np.array(parameter["std"], dtype=float))
        yield name, parameter["unit"], values.tolist(), deviations.tolist()


def _turn_back(found: dict[Key, tuple[float, float]], angle: float) -> None:
    """Forces and tilts in a base frame turned about the vertical as the frame before has them, in place."""
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    force = [("external_force", "force", -k) for k in range(2)]
    if force[0] in found:
        turned = back @ [found[key][0] for key in force]
        found |= {key: (x, found[key][1]) for key, x in zip(force, turned, strict=True)}
    tilt = [("base_tilt", "roll", 0), ("base_tilt", "pitch", 0)]
    if tilt[0] in found:
        roll, pitch = (found[key][0] for key in tilt)
        # the vertical in the base frame, up to its sign
        x, y, z = (
            -np.sin(pitch),
            np.cos(pitch) * np.sin(roll),
            np.cos(pitch) * np.cos(roll),
        )
        x, y = back @ [x, y]
        angles = (np.arctan2(y, z), -np.arcsin(x))
        found |= {key: (a, found[key][1]) for key, a in zip(tilt, angles, strict=True)}
