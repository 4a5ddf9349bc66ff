"""A diagnosis in words: the verdict as a sentence, effects, joints and parameters by their readable names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from gapscope.diagnosis.display import display_unit, percent, significant, uncertain
from gapscope.effects.catalogue import CATALOGUE

Document = Mapping[str, Any]

VERDICTS = {
    "effects_found": "Effects found",
    "no_gap": "No gap",
    "unexplained": "Unexplained gap",
}
_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


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
        unit = (
            self.unit if self.unit.startswith("°") or not self.unit else f" {self.unit}"
        )
        return (
            ", ".join(f"{label} {value}".strip() for label, value in self.entries)
            + unit
        )


def effect_name(name: str) -> str:
    """Readable name of an effect: ``coulomb_friction`` becomes ``Coulomb friction``."""
    return " ".join(_PROPER.get(word, word) for word in name.split("_"))


def capital(text: str) -> str:
    """The text with a capital first letter, unless it begins with a symbol in an inequality: ``q > 0.5 rad``."""
    return text if text[1:3] in (" <", " >") else text[:1].upper() + text[1:]


def listing(parts: Sequence[str]) -> str:
    """Parts joined as in a sentence: ``a, b and c``."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def joint_ranges(joints: Sequence[int]) -> list[str]:
    """Numbers of joints, three and more in a row as a range: ``["1–4", "6"]``."""
    runs: list[list[int]] = []
    for joint in sorted(joints):
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    return [
        part
        for run in runs
        for part in ([f"{run[0]}–{run[-1]}"] if len(run) > 2 else [str(j) for j in run])
    ]


def acts_on(entry: Mapping[str, Any]) -> str:
    """What an effect of the document acts on, as in a sentence: ``joints 4 and 5``, ``link 3``, ``the whole arm``."""
    if entry["joints"]:
        return f"joint{'s' if len(entry['joints']) > 1 else ''} {listing(joint_ranges(entry['joints']))}"
    if "link" in entry.get("parameters", {}):
        return f"link {entry['parameters']['link']['value']:.0f}"
    definition = CATALOGUE.get(entry["effect"])
    return (
        "one link"
        if definition is not None and definition.scope == "link"
        else "the whole arm"
    )


def joint_names(document: Document) -> list[str]:
    """Names of the joints; empty strings if the document has none."""
    n = len(document["gap"]["before"]["torque_nrmse"])
    return list(document["arm"]["joints"]) if "arm" in document else [""] * n


def short_names(names: Sequence[str]) -> list[str]:
    """Names without what they share at both ends; empty strings if only the joint's number is left."""
    start = _shared(names)
    end = _shared([name[start:][::-1] for name in names])
    short = [name[start : len(name) - end].strip("_- ") for name in names]
    counted = all(
        name.lstrip("0") == str(number) for number, name in enumerate(short, 1)
    )
    return [""] * len(names) if counted else short


def _shared(names: Sequence[str]) -> int:
    """Number of leading characters that all names share; 0 for a single name."""
    if len(names) < 2:
        return 0
    return sum(
        1
        for _ in takewhile(
            lambda letters: len(set(letters)) == 1, zip(*names, strict=False)
        )
    )


def gap_rows(document: Document) -> list[tuple[Any, Any, Any]]:
    """Torque NRMSE [1] per joint: before, after, floor; ``None`` if not known."""
    before, after = document["gap"]["before"], document["gap"]["after"]
    return list(
        zip(before["torque_nrmse"], after["torque_nrmse"], before["floor"], strict=True)
    )


def gap_closed(document: Document) -> float | None:
    """Share of the gap above the floor that the effects close, sum(before - after) / sum(before - floor) [1].

    Sums run over the joints whose three values are known. ``None`` if no gap was above the floor, or
    if the verdict is that there is none.
    """
    if document["verdict"] == "no_gap":
        return None
    known = [row for row in gap_rows(document) if None not in row]
    above = sum(b - f for b, _, f in known)
    return min(sum(b - a for b, a, _ in known) / above, 1.0) if above > 0.0 else None


def worst_joint(document: Document, stage: str) -> int | None:
    """Joint whose torque gap exceeds the floor most, ``before`` or ``after``; ``None`` if none does."""
    pairs = zip(
        document["gap"][stage]["torque_nrmse"],
        document["gap"]["before"]["floor"],
        strict=True,
    )
    above = [
        (g - f, joint)
        for joint, (g, f) in enumerate(pairs, 1)
        if g is not None and f is not None and g > f
    ]
    return max(above)[1] if above else None


def effects_text(document: Document) -> str:
    """The effects found with what they act on, as in a sentence; of more than four only the largest three."""
    places = [acts_on(entry) for entry in document["effects"]]
    names = [effect_name(entry["effect"]) for entry in document["effects"]]
    pairs = zip(names, places, strict=True)
    parts = [
        name if place == "the whole arm" else f"{name} ({place})"
        for name, place in pairs
    ]
    return listing(
        parts if len(parts) <= 4 else [*parts[:3], f"{len(parts) - 3} more effects"]
    )


def verdict_sentence(document: Document) -> str:
    """The verdict in one sentence of plain English."""
    effects, closed = document["effects"], gap_closed(document)
    if document["verdict"] == "no_gap":
        return "The nominal arm predicts every joint's torque as well as a healthy arm of this kind allows."
    if document["verdict"] == "effects_found":
        verb, them = ("explains", "it") if len(effects) == 1 else ("explain", "them")
        found = f"{capital(effects_text(document))} {verb} the gap"
        if closed is None:
            return f"{found}; the torque gap was at its floor already."
        return f"{found}: adding {them} to the simulator closes {percent(closed)} of what lies above the floor."
    worst = worst_joint(document, "after")
    most = f", most of it on joint {worst}" if worst else ""
    left = percent(document["unexplained"]["share"])
    if not effects:
        return f"No effect in the catalogue explains the gap: {left} of it stays open{most}."
    verb = "explains" if len(effects) == 1 else "explain"
    return f"{capital(effects_text(document))} {verb} a part of the gap, but {left} of it stays open{most}."


def sides_sentence(document: Document) -> str:
    """On which side of the joint torque sensors the nominal arm's gap lies, in one sentence."""
    carried = document["sides"]["carried_by"]
    parts = []
    for side in ("actuator", "link", "both"):
        joints = [number for number, where in enumerate(carried, 1) if where == side]
        if joints:
            on = "on both sides" if side == "both" else f"on the {side} side"
            parts.append(
                f"{on} of joint{'s' if len(joints) > 1 else ''} {listing(joint_ranges(joints))}"
            )
    return (
        f"The gap lies {listing(parts)}."
        if parts
        else "The gap stands above its floor on neither side of any joint."
    )


def unexplained_sentence(document: Document) -> str:
    """The unexplained part of the gap, in one sentence."""
    share = percent(document["unexplained"]["share"])
    if document["unexplained"]["above_floor"]:
        return f"{share} of the gap stays unexplained and lies above the floor: something real is still missing."
    return f"{share} of the gap stays unexplained, within the floor of what a healthy arm leaves."


def parameter_texts(effect: Mapping[str, Any]) -> list[ParameterText]:
    """Parameters of one entry of ``effects``, in readable units, signed if they add to the nominal arm."""
    definition = CATALOGUE.get(effect["effect"])
    known = {p.name: p for p in definition.parameters} if definition else {}
    texts = []
    for name, parameter in effect["parameters"].items():
        value, std = parameter["value"], parameter["std"]
        values = value if isinstance(value, (list, tuple)) else [value]
        stds = std if isinstance(std, (list, tuple)) else [std] * len(values)
        labels = [f"J{joint}" for joint in effect["joints"]] or (
            list("xyz") if len(values) == 3 else [""] * len(values)
        )
        factor, unit = display_unit(
            parameter["unit"], max((abs(v) for v in values), default=0.0)
        )
        signed = name in known and known[name].increment
        entries = tuple(
            (label, uncertain(factor * v, None if s is None else factor * s, signed))
            for label, v, s in zip(labels, values, stds, strict=True)
        )
        texts.append(
            ParameterText(
                name.replace("_", " "),
                known[name].symbol if name in known else "",
                entries,
                unit,
            )
        )
    return texts


def pulled_texts(effect: Mapping[str, Any]) -> list[str]:
    """Values by the commands as instruments that lie two deviations, and a twentieth, off those found."""
    out = []
    for name, parameter in effect["parameters"].items():
        if "by_commands" not in parameter or parameter["std"] is None:
            continue
        columns = [
            np.atleast_1d(parameter[key]).tolist()
            for key in ("value", "std", "by_commands")
        ]
        labels = [f"J{joint}" for joint in effect["joints"]] or ["x", "y", "z"][
            : len(columns[0])
        ]
        factor, unit = display_unit(parameter["unit"], max(map(abs, columns[0])))
        for label, value, std, other in zip(labels, *columns, strict=False):
            if abs(other - value) > max(2 * std, 0.05 * abs(value)):
                place = f" {label}" if len(columns[0]) > 1 or effect["joints"] else ""
                out.append(
                    f"{name.replace('_', ' ')}{place} {significant(factor * other)} {unit}".strip()
                )
    return out
