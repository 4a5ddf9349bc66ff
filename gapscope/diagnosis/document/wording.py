"""Effects, joints and parameters of a diagnosis by their readable names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.display import display_unit, significant, uncertain
from gapscope.effects.catalogue import known_effect
from gapscope.effects.coupled_motors import COUPLED_MOTORS

Document = Mapping[str, Any]

VERDICTS = {
    "effects_found": "Effects found",
    "no_gap": "No gap",
    "unexplained": "Unexplained gap",
}


@dataclass(frozen=True)
class ParameterText:
    """One parameter of an effect, ready to print.

    Attributes:
        name: name of the parameter.
        symbol: its symbol in the equation, or an empty string.
        entries: pairs of label (``J4``, ``x``, or empty for a number) and ``value ± std``.
        unit: unit of all entries.
    """

    name: str
    symbol: str
    entries: tuple[tuple[str, str], ...]
    unit: str

    @property
    def text(self) -> str:
        """All on one line."""
        values = [f"{label} {value}".strip() for label, value in self.entries]
        # A degree sign follows its number without a space.
        no_space = not self.unit or self.unit.startswith("°")
        unit = self.unit if no_space else f" {self.unit}"
        return ", ".join(values) + unit


def capital(text: str) -> str:
    """The text with a capital first letter, unless it begins with a symbol in an inequality: ``q > 0.5 rad``."""
    return text if text[1:3] in (" <", " >") else text[:1].upper() + text[1:]


def coupling_text(entry: Mapping[str, Any]) -> str:
    """How a case declares a coupled motor: ``nominal: {coupling: [{motor: 6, joint: 5, ratio: 1}]}``."""
    values = ", ".join(f"{key}: {value:g}" for key, value in entry.items())
    return f"nominal: {{coupling: [{{{values}}}]}}"


def listing(parts: Sequence[str]) -> str:
    """Parts joined as in a sentence: ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    first = ", ".join(parts[:-1])
    return f"{first} and {parts[-1]}"


def joint_ranges(joints: Sequence[int]) -> list[str]:
    """Numbers of joints, three and more in a row as a range: ``["1–4", "6"]``."""
    runs: list[list[int]] = []
    for joint in sorted(joints):
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])

    parts = []
    for run in runs:
        if len(run) > 2:
            parts.append(f"{run[0]}–{run[-1]}")
        else:
            parts += [str(joint) for joint in run]
    return parts


def holds_in(entry: Mapping[str, Any]) -> list[str]:
    """In which recordings an effect has its values, and what it is in others; nothing if it is the same in all."""
    if "recordings" not in entry:
        return []
    texts = [f"in {listing(entry['recordings'])}"]
    for other in entry["elsewhere"]:
        values = parameter_texts({"effect": entry["effect"], **other})
        sizes = ", ".join(f"{value.name} {value.text}" for value in values)
        texts.append(f"in {listing(other['recordings'])} {sizes}")
    return texts


def acts_on(entry: Mapping[str, Any]) -> str:
    """What an effect of the document acts on, as in a sentence: ``joints 4 and 5``, ``link 3``, ``the whole arm``."""
    joints = entry["joints"]
    if joints:
        part = "motor" if entry["effect"] in COUPLED_MOTORS else "joint"
        plural = "s" if len(joints) > 1 else ""
        return f"{part}{plural} {listing(joint_ranges(joints))}"
    parameters = entry.get("parameters", {})
    if "link" in parameters:
        return f"link {parameters['link']['value']:.0f}"

    # An alternative has no parameters: which link is not said.
    definition = known_effect(entry["effect"])
    if definition is not None and definition.scope == "link":
        return "one link"
    return "the whole arm"


def joint_names(document: Document) -> list[str]:
    """Names of the joints; empty strings if the document has none."""
    n = len(document["gap"]["before"]["torque_nrmse"])
    return list(document["arm"]["joints"]) if "arm" in document else [""] * n


def joint_slides(document: Document) -> list[bool]:
    """Whether each joint slides."""
    sliding = document.get("arm", {}).get("sliding", [])
    return [joint in sliding for joint in range(1, len(joint_names(document)) + 1)]


def short_names(names: Sequence[str]) -> list[str]:
    """Names without what they share at both ends; empty strings if only the joint's number is left."""
    start = _shared(names)
    reversed_rest = [name[start:][::-1] for name in names]
    end = _shared(reversed_rest)
    inner = [name[start : len(name) - end] for name in names]
    short = [name.strip("_- ") for name in inner]

    numbers = [str(number) for number in range(1, len(names) + 1)]
    only_numbers = [name.lstrip("0") for name in short] == numbers
    return [""] * len(names) if only_numbers else short


def _shared(names: Sequence[str]) -> int:
    """Number of leading characters that all names share; 0 for a single name."""
    if len(names) < 2:
        return 0
    count = 0
    for letters in zip(*names, strict=False):
        if len(set(letters)) > 1:
            break
        count += 1
    return count


def gap_rows(document: Document) -> list[tuple[Any, Any, Any]]:
    """Torque NRMSE [1] per joint: before, after, floor; ``None`` if not known."""
    gap = document["gap"]
    before, after = gap["before"]["torque_nrmse"], gap["after"]["torque_nrmse"]
    return list(zip(before, after, gap["before"]["floor"], strict=True))


def worst_joint(document: Document, stage: str) -> int | None:
    """Joint whose torque gap exceeds the floor most, ``before`` or ``after``; ``None`` if none does."""
    gaps = document["gap"][stage]["torque_nrmse"]
    floors = document["gap"]["before"]["floor"]
    above = []
    for joint, (gap, floor) in enumerate(zip(gaps, floors, strict=True), 1):
        if gap is not None and floor is not None and gap > floor:
            above.append((gap - floor, joint))
    return max(above)[1] if above else None


def parameter_texts(effect: Mapping[str, Any]) -> list[ParameterText]:
    """Parameters of one entry of ``effects``, in readable units, signed if they add to the nominal arm."""
    definition = known_effect(effect["effect"])
    known = {p.name: p for p in definition.parameters} if definition else {}
    texts = []
    if "gravity" in effect:
        # angles of a base far from upright say little
        axes = zip("xyz", effect["gravity"], strict=True)
        entries = [
            (axis, f"{round(value, 2) + 0.0:.2f}".replace("-", "−"))
            for axis, value in axes
        ]
        texts.append(ParameterText("gravity", "", tuple(entries), "m/s²"))
    for name, parameter in effect["parameters"].items():
        values = _as_list(parameter["value"], 1)
        stds = _as_list(parameter["std"], len(values))
        largest = max((abs(v) for v in values), default=0.0)
        # joints that turn and that slide have a unit each
        units = parameter.get("units")
        factor, unit = (1.0, "") if units else display_unit(parameter["unit"], largest)
        signed = name in known and known[name].increment

        entries = []
        labels = _labels(effect, len(values))
        for place, (label, value, std) in enumerate(
            zip(labels, values, stds, strict=True)
        ):
            shown_std = None if std is None else factor * std
            text = uncertain(factor * value, shown_std, signed)
            entries.append((label, f"{text} {units[place]}" if units else text))

        symbol = known[name].symbol if name in known else ""
        words = name.replace("_", " ")
        texts.append(ParameterText(words, symbol, tuple(entries), unit))
    return texts


def pulled_texts(effect: Mapping[str, Any]) -> list[str]:
    """Values by the commands as instruments that differ from those found by two deviations and a twentieth."""
    out = []
    for name, parameter in effect["parameters"].items():
        if "by_commands" not in parameter or parameter["std"] is None:
            continue
        values = np.atleast_1d(parameter["value"]).tolist()
        stds = np.atleast_1d(parameter["std"]).tolist()
        by_commands = np.atleast_1d(parameter["by_commands"]).tolist()
        labels = _labels(effect, len(values))
        factor, unit = display_unit(parameter["unit"], max(map(abs, values)))
        words = name.replace("_", " ")

        for label, value, std, other in zip(
            labels, values, stds, by_commands, strict=True
        ):
            if abs(other - value) > max(2 * std, 0.05 * abs(value)):
                place = f" {label}" if label else ""
                number = significant(factor * other)
                out.append(f"{words}{place} {number} {unit}".strip())
    return out


def _as_list(value: Any, count: int) -> list[Any]:
    """The entries of a list; a single value as often as there are entries."""
    return list(value) if isinstance(value, (list, tuple)) else [value] * count


def _labels(effect: Mapping[str, Any], count: int) -> list[str]:
    """What the entries of an effect's parameter belong to: joints, motors, the axes of a vector, or nothing."""
    letter = "M" if effect["effect"] in COUPLED_MOTORS else "J"
    if effect["joints"]:
        return [f"{letter}{joint}" for joint in effect["joints"]]
    return list("xyz") if count == 3 else [""] * count
