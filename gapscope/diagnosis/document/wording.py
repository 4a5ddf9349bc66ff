"""Words and numbers of a diagnosis as a person reads them."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gapscope.arm.display import (
    display_unit,
    effect_name,
    listing,
    percent,
    significant,
    uncertain,
    unit_name,
)
from gapscope.arm.joint_units import SLIDING_UNITS, common_unit, joint_unit, units_of
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.document.numbers import AXES
from gapscope.diagnosis.thresholds import (
    HEALTHY_REAL,
    INERTIAL_ERROR,
    NO_TORQUE,
    OPEN_ALTERNATIVE,
)
from gapscope.effects.catalogue import COUPLED_MOTORS, known_effect
from gapscope.model.changes import change_text

# Units of ``diagnosis.json`` on an arm with sliding joints: m, N and kg where an entry is about a slide.


_LONGEST_FIRST = sorted(SLIDING_UNITS, key=len, reverse=True)
_IN_TEXT = re.compile(
    r"(?<![\w/])(" + "|".join(map(re.escape, _LONGEST_FIRST)) + r")(?![\w/²^])"
)
"""A unit with an angle in a text."""


def with_slide_units(content: dict[str, Any], sliding: Sequence[bool]) -> Any:
    """The document with the units of slides; as it is for an arm whose joints all turn.

    An entry with ``joint`` or ``joints`` is about those, and so is what it holds. A parameter of joints of both kinds
    has both units in ``unit``, and one for each value in ``units``.
    """
    # nearly all arms: nothing to convert
    if not any(sliding):
        return content
    return _converted(content, sliding, ())


def _converted(node: Any, sliding: Sequence[bool], about: Sequence[bool]) -> Any:
    """A part of the document, about joints that slide or turn."""
    if isinstance(node, list):
        return [_converted(each, sliding, about) for each in node]
    if isinstance(node, str):
        # a text about joints of both kinds keeps its units: whose they are is not known
        return in_text(node) if about and all(about) else node
    if not isinstance(node, Mapping):
        return node
    # an entry without joints of its own is about those of the entry around it
    about = _about(node, sliding) or about
    out = {
        # units of values are done below, when all joints are known
        key: value if key == "unit" else _converted(value, sliding, about)
        for key, value in node.items()
    }
    if isinstance(unit := node.get("unit"), str) and any(about):
        out["unit"] = common_unit(unit, about)
        if not all(about) and joint_unit(unit, True) != unit:
            out["units"] = units_of(unit, about)
    return out


def _about(node: Mapping[str, Any], sliding: Sequence[bool]) -> tuple[bool, ...]:
    """Which of the joints that an entry names slide; empty if it names none."""
    joints = node.get("joints", node.get("joint"))
    numbers = [joints] if isinstance(joints, int) else joints or []
    if not all(isinstance(number, int) for number in numbers):
        return ()
    return tuple(bool(sliding[number - 1]) for number in numbers)


def in_text(text: str) -> str:
    """A text about a slide with its units."""
    return _IN_TEXT.sub(lambda match: joint_unit(match[1], True), text)


# What the verdict rests on, in words.


Verdict = Literal["effects_found", "no_gap", "unexplained"]


def misread(
    off: float, shown: np.ndarray, said: np.ndarray, *, another: bool
) -> tuple[str, str]:
    """What makes the nominal arm another one than was recorded, and what to do; empty if nothing does.

    Args:
        off: its gap over the joints, RMS of torque NRMSE [1].
        shown: gravity that the torque shows, in the frame of the base [m/s^2], (3,); ``said`` itself if it is that.
        said: gravity that the case says, likewise.
        another: whether no ordinary load, friction or error of its bodies explains the torque.
    """
    if another:
        return (
            "probably another robot's URDF, or columns in another order or unit: the nominal arm's torque is off by "
            f"{much(off)} the recorded one, and no ordinary load, friction or error of its links explains that",
            "check robot:, joints: and the units and columns of import:",
        )
    # the same object unless the base is mounted turned
    if shown is not said:
        # adding 0.0 makes -0.0 a plain zero
        found, given = ([round(float(x), 2) + 0.0 for x in g] for g in (shown, said))
        return (
            f"the torque shows gravity {found} m/s^2 in the frame of the base, the case says {given}: the base is "
            "mounted turned",
            f"say in the case gravity: {found}",
        )
    if off > NO_TORQUE:
        return (
            f"the nominal arm's torque is off by {much(off)} the recorded one, more than a constant torque would "
            "be: a load or friction that the case does not state, inertials that are far off, another unit, or another "
            "robot's URDF",
            "check payloads:, nominal: and robot:",
        )
    return "", ""


def another_scale(factor: float, std: float) -> tuple[str, str]:
    """That a factor on all torques would fit the nominal arm, and what to do.

    Args:
        factor: it [1].
        std: its deviation [1].
    """
    return (
        f"all torques times about {uncertain(factor, std)} would fit the nominal arm, a load explains them less well: "
        "they are in another unit, made with other motor constants or gear ratios, or it is another robot's URDF",
        "compare robot: and motors with data sheets; if a factor is all that is wrong, import: {mend: {torque: "
        f"{{scale: {significant(factor)}}}}}}} puts it right",
    )


def much(gap: float) -> str:
    """A gap over the torque's deviation [1] in words, before what it is of: ``73 % of``, ``24 times``."""
    return f"{percent(gap)} of" if gap < 10 else f"{gap:.0f} times"


# Effects, joints and parameters of a diagnosis by their readable names.


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


def joint_ranges(joints: Sequence[int]) -> list[str]:
    """Numbers of joints, three and more in a row as a range: ``["1–4", "6"]``."""
    parts: list[str] = []
    # numbers in a row differ from their places by the same
    places = enumerate(sorted(joints))
    for _, row in itertools.groupby(places, lambda each: each[1] - each[0]):
        run = [str(joint) for _, joint in row]
        parts += [f"{run[0]}–{run[-1]}"] if len(run) > 2 else run
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
    if "arm" in document:
        return list(document["arm"]["joints"])
    return [""] * len(document["gap"]["before"]["torque_nrmse"])


def joint_slides(document: Document) -> list[bool]:
    """Whether each joint slides."""
    sliding = document.get("arm", {}).get("sliding", [])
    return [joint in sliding for joint in range(1, len(joint_names(document)) + 1)]


def short_names(names: Sequence[str]) -> list[str]:
    """Names without what they share at both ends; empty strings if only the joint's number is left."""
    short = list(names)
    if len(short) > 1:
        # the common beginning first; then, turned round, the common end
        for _ in range(2):
            letters = enumerate(zip(*short, strict=False))
            unlike = (k for k, each in letters if len(set(each)) > 1)
            shared = next(unlike, min(map(len, short)))
            short = [name[shared:][::-1] for name in short]
    short = [name.strip("_- ") for name in short]
    numbers = [str(number) for number in range(1, len(names) + 1)]
    only_numbers = [name.lstrip("0") for name in short] == numbers
    return [""] * len(names) if only_numbers else short


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
        # as a case file says it; angles of a base far from upright say little
        texts.append(
            ParameterText("gravity", "", (("", gravity_text(effect)),), "m/s²")
        )
    beyond = effect.get("torque_at_middle", [None] * len(effect["joints"]))
    for name, parameter in effect["parameters"].items():
        if name == "link":
            # what the effect acts on says it
            continue
        values = _as_list(parameter["value"], 1)
        stds = _as_list(parameter["std"], len(values))
        if "gravity" in effect and max(s or 0.0 for s in stds) > 0.5:
            # an angle that is not known to half a radian says nothing
            continue
        # one prefix for all entries of a parameter: by the largest number in it
        largest = max((abs(v) for v in (*values, *stds) if v is not None), default=0.0)
        # joints that turn and that slide have a unit each
        units = parameter.get("units")
        factor, unit = (1.0, "") if units else display_unit(parameter["unit"], largest)
        signed = name in known and known[name].increment

        entries = []
        labels = _labels(effect, len(values))
        for place, (label, value, std) in enumerate(
            zip(labels, values, stds, strict=True)
        ):
            # said below, by what the spring does within the range
            if name == "rest" and beyond[place] is not None:
                continue
            shown_std = None if std is None else factor * std
            text = uncertain(factor * value, shown_std, signed)
            entries.append((label, f"{text} {units[place]}" if units else text))

        symbol = known[name].symbol if name in known else ""
        words = name.replace("_", " ")
        texts.append(ParameterText(words, symbol, tuple(entries), unit))
    # where a spring rests beyond its range is known badly, what it does within well
    pairs = zip(_labels(effect, len(beyond)), beyond, strict=True)
    far = [(label, significant(value)) for label, value in pairs if value is not None]
    if far:
        words = "no rest inside the range, torque at its middle"
        texts.append(ParameterText(words, "", tuple(far), "N m"))
    return [text for text in texts if text.entries]


def gravity_text(effect: Mapping[str, Any]) -> str:
    """Gravity in the frame of a base that is turned [m/s^2], as a case file says it."""
    numbers = (f"{round(value, 2) + 0.0:.2f}" for value in effect["gravity"])
    return f"[{', '.join(numbers)}]"


def pulled_texts(effect: Mapping[str, Any]) -> list[str]:
    """Values by the commands as instruments that differ from those found by two deviations and a twentieth."""
    out = []
    for name, parameter in effect["parameters"].items():
        # without a deviation no difference is significant
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
    return list(AXES) if count == len(AXES) else [""] * count


# A diagnosis in sentences: the main cause, its share and what stays; what is possible; what is unexplained.


MAX_CHANGES = 2
"""Changes during recordings that a sentence names."""
MAX_CAUSES = 3
"""Effects that a sentence names."""


def verdict_sentence(document: Document) -> str:
    """The main cause, its share of the gap, and what stays; first, whether the recordings share a state."""
    states, cause = states_sentence(document), _cause_sentence(document)
    # goes on after a colon
    if states and cause.startswith(("No", "The", "What")):
        cause = cause[0].lower() + cause[1:]
    return states + cause


def states_sentence(document: Document) -> str:
    """What differs between the recordings, if they do not share a state; else empty."""
    states = document.get("states")
    if states is None or states["shared"]:
        return ""
    differs = states["differs"]
    texts = [_differing(entry, states["recordings"]) for entry in differs[:MAX_CAUSES]]
    if len(texts) < len(differs):
        texts.append(f"{len(differs) - len(texts)} more")
    where = listing(states.get("diagnosed", states["recordings"]))
    return f"The recordings do not share a state: {listing(texts)} ({states['command']} compares them). In {where}: "


def _differing(entry: Mapping[str, Any], recordings: Sequence[str]) -> str:
    """A quantity that differs, with its value in each recording."""
    # a load has mass and place, not one value
    if any("first_moment" in each for each in entry["parameters"]):
        return _other_loads(entry, recordings)
    values = [
        "?" if std is None else f"{uncertain(value, std)}"
        for value, std in zip(entry["values"], entry["std"], strict=True)
    ]
    pairs = [f"{v} in {name}" for v, name in zip(values, recordings, strict=True)]
    unit = unit_name(entry["unit"])
    named = f"{entry['name']} [{unit}]" if unit else entry["name"]
    return f"{named} is {', '.join(pairs)}"


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
        return f"{capital(_nothing_unknown(document))}."
    if document.get("changes"):
        return f"{_changed(document)} {_before_changes(document)}"
    return _explained(document)


def _changed(document: Document) -> str:
    """What changed during recordings, in a sentence."""
    texts = [change_text(entry) for entry in document["changes"]]
    shown = texts[:MAX_CHANGES]
    if len(shown) < len(texts):
        more = len(texts) - len(shown)
        shown.append(f"{more} more change{'s' if more > 1 else ''}")
    return f"{capital(listing(shown))}."


def _before_changes(document: Document) -> str:
    """The other findings, which are of the arm before it changed."""
    if document["effects"] or document["verdict"] == "unexplained":
        return f"Before that: {_explained(document)}"
    return f"Before that nothing stands out: {_nothing_unknown(document)}."


def _explained(document: Document) -> str:
    """The main cause, its share of the gap, and what stays."""
    if "misread" in document:
        return f"{capital(document['misread'])}. No effect is named."
    if _diagnosed(document):
        return f"{capital(_causes(document))}; {_left(document)}."
    if document["effects"] and document["verdict"] != "unexplained":
        return f"Nothing stands out: {_nothing_unknown(document)}."
    if document["possible"]:
        return f"No effect reaches 50 % probability: {_left(document)}."
    if document["closed"] is None:
        return f"No effect in the catalogue explains the gap: {_left(document)}."
    return f"No effect in the catalogue explains the gap{_mostly_on(document)}."


def _nothing_unknown(document: Document) -> str:
    """Why nothing that is left asks for a cause: small, as healthy real arms have it, or errors of the data sheet."""
    after = document["gap"]["after"]["torque_nrmse"]
    shares = [share or 0.0 for share in after]
    left = max(shares)
    if left <= HEALTHY_REAL[0]:
        return "what the nominal arm misses of the torque is noise"
    least, most = (percent(share) for share in HEALTHY_REAL)
    healthy = f"models of healthy real arms miss ({least} to {most} over all joints)"
    # a comparison with a reference has no data sheet
    off = document.get("conditioning", {}).get("nominal_inertials_std") or 0.0
    large = rms(np.array(shares)) > HEALTHY_REAL[1] and off > 0
    how = (
        f"more than {healthy}, but errors of the data sheet explain it"
        if large
        else f"no more than {healthy}, and follows the motion on no joint by more than the others leave"
    )
    text = (
        "what the nominal arm misses of the torque, "
        f"at most {percent(left)} (joint {shares.index(left) + 1}), is {how}"
    )
    # no gap to explain by an effect does not mean that the sheet is right
    if large or off > INERTIAL_ERROR:
        text += f"; the bodies of the robot file are likeliest off by about {percent(off)} of their size"
    return text


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
    # what closes nothing is no explanation of the gap
    if not document["closed"]:
        names = [with_amount(entry) for entry in effects[:MAX_CAUSES]]
        more = len(effects) - len(names)
        names += [f"{more} more effect{'s' if more > 1 else ''}"] if more else []
        verb = "is" if len(effects) == 1 else "are"
        return f"{listing(names)} {verb} found"

    # the last of the places is that of the sum of all others
    shown = effects if len(effects) <= MAX_CAUSES else effects[: MAX_CAUSES - 1]
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
            return "no joint exceeds its noise floor"
        joints = joint_ranges(document["unexplained"]["joints"])
        return (
            f"what exceeds the noise floor on joint {listing(joints)} stays unexplained"
        )
    share = document["unexplained"]["share"]
    if share == 0.0:
        return "nothing stays unexplained"
    return f"{percent(share)} stays unexplained{_mostly_on(document)}"


def _mostly_on(document: Document) -> str:
    """The joint that has most of what is left, after a comma; empty if none has."""
    worst = worst_joint(document, "after")
    above = [
        after > floor
        for _, after, floor in gap_rows(document)
        if None not in (after, floor)
    ]
    place = "on" if sum(above) == 1 else "most of it on"
    return f", {place} joint {worst}" if worst else ""


def with_amount(entry: Mapping[str, Any]) -> str:
    """An effect with its size, if one number says it, and what it acts on: ``payload of 2.80 kg``."""
    amount, place = _amount(entry), acts_on(entry)
    size = f" of {amount}" if amount else ""
    # of a fault of the whole arm which it is
    kind = entry.get("variant", "").replace("_", " ")
    place = kind if place == "the whole arm" else place
    on = f" ({place})" if place else ""
    return f"{called(entry)}{size}{on}"


def called(entry: Mapping[str, Any]) -> str:
    """An effect by its name, or by any of those that no motion tells from it: ``base tilt or torque offset``."""
    others = [
        other["effect"]
        for other in entry.get("alternatives", ())
        if other.get("equivalent") and other["probability"] >= OPEN_ALTERNATIVE
    ]
    *names, last = (effect_name(name) for name in (entry["effect"], *others))
    return f"{', '.join(names)} or {last}" if names else last


def _amount(entry: Mapping[str, Any]) -> str:
    """The first parameter of an effect that the torque shows; nothing for several joints, axes or angles."""
    definition = known_effect(entry["effect"])
    # a fault of the set-up, or what shows in no torque
    if definition is None or definition.parametrisation is None:
        return ""
    known = [values for name, values in entry["parameters"].items() if name != "link"]
    if not known:
        return ""
    first, *others = known
    values = first["value"] if isinstance(first["value"], list) else [first["value"]]
    # one of several angles or lengths says too little by itself
    alike = any(other["unit"] == first["unit"] for other in others)
    if len(values) != 1 or alike:
        return ""
    factor, unit = display_unit(first["unit"], abs(values[0]))
    return f"{significant(factor * values[0])} {unit}".strip()


def possible_texts(document: Document) -> list[str]:
    """What is possible and not confirmed, each with its probability and what would settle it."""
    return [
        f"{with_amount(entry)}, {percent(entry['probability'])}; to confirm, record {entry['settled_by']}"
        for entry in document["possible"]
    ]


def unexplained_sentence(document: Document) -> str:
    """The unexplained part of the gap, in one sentence."""
    if document["verdict"] == "no_gap":
        return "Nothing needs an explanation."
    left = _left(document)
    coupling = document["unexplained"].get("coupling")
    if coupling is not None:
        one, other = coupling["joints"]
        return (
            f"{capital(left)}. The residuals of joints {one} and {other} share friction as the joints of one motor do: "
            f"if a motor turns both, declare {coupling_text(coupling['declare'])}."
        )
    if document["unexplained"]["above_floor"]:
        return f"{capital(left)}: a cause is missing."
    if document["unexplained"]["share"] == 0.0:
        return f"{capital(left)}."
    return f"{capital(left)}; what is named explains more than that."


def sides_sentence(document: Document) -> str:
    """On which side of the joint torque sensors the nominal arm's gap lies, in one sentence."""
    carried = document["sides"]["carried_by"]
    parts = []
    for side in ("actuator", "link", "both"):
        # joints of neither side are not listed
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
    # zeros are no statement: a data sheet without friction is silent
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
    # a thousandth of each: joints of both kinds count apart
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
