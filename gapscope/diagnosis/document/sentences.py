"""A diagnosis in sentences: the main cause, its share and what stays; what is possible; what is unexplained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gapscope.arm.display import (
    display_unit,
    effect_name,
    percent,
    significant,
    uncertain,
)
from gapscope.arm.joint_units import joint_unit
from gapscope.diagnosis.document.wording import (
    Document,
    acts_on,
    capital,
    coupling_text,
    gap_rows,
    joint_ranges,
    joint_slides,
    listing,
    worst_joint,
)
from gapscope.effects.catalogue import known_effect
from gapscope.model.change_findings import change_text

MOST_CHANGES = 2
"""Changes during recordings that a sentence names."""
MOST_CAUSES = 3
"""Effects that a sentence names."""
HEALTHY_REAL = 0.23
"""Torque NRMSE that a complete model of a healthy real arm may leave on a joint: 0.04 to 0.23 on six public arms."""


def verdict_sentence(document: Document) -> str:
    """The main cause, its share of the gap, and what stays; first, whether the recordings share a state."""
    states, cause = states_sentence(document), _cause_sentence(document)
    if states and cause.startswith(("No", "The")):
        cause = cause[0].lower() + cause[1:]
    return states + cause


def states_sentence(document: Document) -> str:
    """What differs between the recordings, if they do not share a state; else empty."""
    states = document.get("states")
    if states is None or states["shared"]:
        return ""
    differs = states["differs"]
    texts = [_differing(entry, states["recordings"]) for entry in differs[:MOST_CAUSES]]
    if len(texts) < len(differs):
        texts.append(f"{len(differs) - len(texts)} more")
    where = listing(states.get("diagnosed", states["recordings"]))
    return f"The recordings do not share a state: {listing(texts)} ({states['command']} compares them). In {where}: "


def _differing(entry: Mapping[str, Any], recordings: Sequence[str]) -> str:
    """A quantity that differs, with its value in each recording."""
    if any("first_moment" in each for each in entry["parameters"]):
        return _other_loads(entry, recordings)
    _, unit = display_unit(entry["unit"], 1.0)
    values = [
        "?" if std is None else f"{uncertain(value, std)}"
        for value, std in zip(entry["values"], entry["std"], strict=True)
    ]
    pairs = [f"{v} in {name}" for v, name in zip(values, recordings, strict=True)]
    unit = "" if entry["unit"] == "1" else f" [{unit}]"
    return f"{entry['name']}{unit} is {', '.join(pairs)}"


def _other_loads(entry: Mapping[str, Any], recordings: Sequence[str]) -> str:
    """Which recordings have another load than the rest, and by what it differs."""
    texts = []
    for name, load, std in zip(
        recordings, entry["parameters"], entry["std"], strict=True
    ):
        if not load:
            continue
        sign = "more" if load["mass"] > 0 else "less"
        mass = f"{uncertain(abs(load['mass']), std)} kg {sign}"
        if "com" in load:
            place = ", ".join(significant(1e3 * x) for x in load["com"])
            texts.append(f"{mass} in {name} (a body centred at ({place}) mm)")
        else:
            moment = ", ".join(significant(x) for x in load["first_moment"])
            texts.append(f"{mass} in {name}, its first moment ({moment}) kg m more")
    return f"{entry['name']} is another, {'; '.join(texts)}"


def _cause_sentence(document: Document) -> str:
    """The main cause, its share of the gap, and what stays, in one sentence of plain English."""
    if document["verdict"] == "no_gap":
        return "The nominal arm predicts every joint's torque as well as a healthy arm of this kind allows."
    if document.get("changes"):
        return f"{_changed(document)} {_before_changes(document)}"
    return _explained(document)


def _changed(document: Document) -> str:
    """What changed during recordings, in a sentence."""
    texts = [change_text(entry) for entry in document["changes"]]
    shown = texts[:MOST_CHANGES]
    if len(shown) < len(texts):
        shown.append(f"{len(texts) - len(shown)} more changes")
    return f"{capital(listing(shown))}."


def _before_changes(document: Document) -> str:
    """The other findings, which are of the arm before it changed."""
    if document["effects"] or document["verdict"] == "unexplained":
        return f"Before that: {_explained(document)}"
    return "Before that nothing stands out: the nominal arm predicts every joint's torque as a healthy arm allows."


def _explained(document: Document) -> str:
    """The main cause, its share of the gap, and what stays."""
    if _diagnosed(document):
        text = f"{capital(_causes(document))}; {_left(document)}."
    elif document["effects"] and document["verdict"] != "unexplained":
        text = "Nothing stands out: the nominal arm predicts every joint's torque as a healthy arm allows."
    elif document["possible"]:
        text = f"No effect is sure enough to be named as the cause: {_left(document)}."
    else:
        text = f"No effect in the catalogue explains the gap: {_left(document)}."
    return text + _as_much_as_real_arms(document)


def _as_much_as_real_arms(document: Document) -> str:
    """A further sentence if what stays unexplained is no more than a healthy real arm may leave; empty otherwise."""
    if document["verdict"] != "unexplained":
        return ""
    after = document["gap"]["after"]["torque_nrmse"]
    left = [after[joint - 1] for joint in document["unexplained"].get("joints", ())]
    if not left or None in left or max(left) > HEALTHY_REAL:
        return ""
    return (
        f" On a real arm this need not be a fault: models of healthy ones leave up to {percent(HEALTHY_REAL)} of a "
        f"joint's torque, here {percent(max(left))}."
    )


def _diagnosed(document: Document) -> list[Mapping[str, Any]]:
    """The effects named, without those that only recordings in another state have."""
    here = document.get("states", {}).get("diagnosed")
    return [
        entry
        for entry in document["effects"]
        if here is None or entry.get("recordings", here) == here
    ]


def _causes(document: Document) -> str:
    """The effects named with their shares; of more than three the largest two and the sum of the others."""
    effects = _diagnosed(document)
    if document["closed"] is None:
        names = [with_amount(entry) for entry in effects[:MOST_CAUSES]]
        more = len(effects) - len(names)
        names += [f"{more} more effects"] if more else []
        verb = "is" if len(effects) == 1 else "are"
        return f"{listing(names)} {verb} found"

    shown = effects if len(effects) <= MOST_CAUSES else effects[: MOST_CAUSES - 1]
    first, *others = shown
    main = f"{with_amount(first)} explains {percent(first['share'])} of the gap"
    parts = [f"{with_amount(entry)} {percent(entry['share'])}" for entry in others]
    if len(shown) < len(effects):
        rest = effects[len(shown) :]
        share = sum(entry["share"] for entry in rest)
        parts.append(f"{len(rest)} more effects {percent(share)}")
    return listing([main, *parts])


def _left(document: Document) -> str:
    """How much of the gap stays unexplained, and where."""
    if document["closed"] is None:
        if not document["unexplained"]["above_floor"]:
            return "no joint's torque gap stands above its floor"
        joints = joint_ranges(document["unexplained"]["joints"])
        return (
            f"what stands above the floor on joint {listing(joints)} stays unexplained"
        )
    share = document["unexplained"]["share"]
    if share == 0.0:
        return "nothing stays unexplained"
    worst = worst_joint(document, "after")
    above = [
        after > floor
        for _, after, floor in gap_rows(document)
        if None not in (after, floor)
    ]
    place = "on" if sum(above) == 1 else "most of it on"
    where = f", {place} joint {worst}" if worst else ""
    return f"{percent(share)} stay unexplained{where}"


def with_amount(entry: Mapping[str, Any]) -> str:
    """An effect with its size, if one number says it, and what it acts on: ``payload of 2.80 kg``."""
    amount, place = _amount(entry), acts_on(entry)
    size = f" of {amount}" if amount else ""
    on = "" if place == "the whole arm" else f" ({place})"
    return f"{effect_name(entry['effect'])}{size}{on}"


def _amount(entry: Mapping[str, Any]) -> str:
    """The first parameter of an effect that the torque shows; nothing for several joints, axes or angles."""
    definition = known_effect(entry["effect"])
    if definition is None or definition.parametrisation is None:
        return ""
    known = [values for name, values in entry["parameters"].items() if name != "link"]
    if not known:
        return ""
    first, *others = known
    values = first["value"] if isinstance(first["value"], list) else [first["value"]]
    alike = any(other["unit"] == first["unit"] for other in others)
    if len(values) != 1 or alike:
        return ""
    factor, unit = display_unit(first["unit"], abs(values[0]))
    return f"{significant(factor * values[0])} {unit}".strip()


def possible_texts(document: Document) -> list[str]:
    """What is possible and not confirmed, each with its probability and what would settle it."""
    return [
        f"{with_amount(entry)}, {percent(entry['probability'])}; would be settled by {entry['settled_by']}"
        for entry in document["possible"]
    ]


def unexplained_sentence(document: Document) -> str:
    """The unexplained part of the gap, in one sentence."""
    if document["verdict"] == "no_gap":
        return (
            "Nothing needs an explanation: a healthy arm of this kind leaves as much."
        )
    left = _left(document)
    coupling = document["unexplained"].get("coupling")
    if coupling is not None:
        one, other = coupling["joints"]
        return (
            f"{capital(left)}. The residuals of joints {one} and {other} share friction as the joints of one motor do: "
            f"if a motor turns both, declare {coupling_text(coupling['declare'])}."
        )
    if document["unexplained"]["above_floor"]:
        return f"{capital(left)}: something real is still missing."
    if document["unexplained"]["share"] == 0.0:
        return f"{capital(left)}."
    return f"{capital(left)}: no more than named effects may leave."


def sides_sentence(document: Document) -> str:
    """On which side of the joint torque sensors the nominal arm's gap lies, in one sentence."""
    carried = document["sides"]["carried_by"]
    parts = []
    for side in ("actuator", "link", "both"):
        joints = [joint for joint, where in enumerate(carried, 1) if where == side]
        if joints:
            on = "on both sides" if side == "both" else f"on the {side} side"
            plural = "s" if len(joints) > 1 else ""
            parts.append(f"{on} of joint{plural} {listing(joint_ranges(joints))}")
    if not parts:
        return "The gap stands above its floor on neither side of any joint."
    return f"The gap lies {listing(parts)}."


def nominal_friction_sentence(document: Document) -> str | None:
    """The nominal arm's friction and where it comes from; ``None`` for a document that does not say."""
    if "nominal" not in document:
        return None
    friction = document["nominal"]["friction"]
    if not any((*friction["coulomb"], *friction["viscous"])):
        return "none stated"
    parts = [
        f"Coulomb {_by_kind(document, friction['coulomb'], 'N m')}",
        f"viscous {_by_kind(document, friction['viscous'], 'N m s/rad')}",
    ]
    source = friction["source"]
    return listing(parts) + (f" (from {source})" if source else "")


def presliding_sentence(document: Document) -> str | None:
    """Over what distance the dry friction found builds up, and on which joints; ``None`` if it acts at once."""
    distances = document.get("presliding", [])
    bent = [joint for joint, distance in enumerate(distances, 1) if distance > 0]
    if not bent:
        return None
    slides, parts = joint_slides(document), []
    for sliding, unit in ((False, "mrad"), (True, "mm")):
        own = [joint for joint in bent if slides[joint - 1] == sliding]
        if own:
            values = [1e3 * distances[joint - 1] for joint in own]
            plural = "s" if len(own) > 1 else ""
            numbers = listing(joint_ranges(own))
            parts.append(f"{_from_to(values, unit)} on joint{plural} {numbers}")
    return listing(parts)


def _by_kind(document: Document, values: list[float], unit: str) -> str:
    """The range of the values of joints that turn, and of those that slide."""
    slides, parts = joint_slides(document), []
    for sliding in (False, True):
        own = [x for x, slid in zip(values, slides, strict=True) if slid == sliding]
        if own:
            parts.append(_from_to(own, joint_unit(unit, sliding)))
    return " and ".join(parts)


def _from_to(values: list[float], unit: str) -> str:
    """The range of the joints' values, or the value that all have."""
    low, high = significant(min(values)), significant(max(values))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
