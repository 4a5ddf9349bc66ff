"""Columns of a log: their words and units, one number for each joint, their time, and which channel they are."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.io.layouts import STEPS_PER_TURN, UNITS, Layout, with_sign
from gapscope.arm.io.plausibility import unit_of_stamps
from gapscope.arm.io.table import Table

# Units and words of an inspection.


SIGN_BITS = (10, 15)
"""Bits in which Feetech servos keep the sign of a load, and of a speed; the lower ones hold the magnitude."""

# What the name of a column says that it holds.


QUANTITIES = {
    "position": {"q", "position", "pos", "angle", "theta", "state", "action"},
    "velocity": {"dq", "qd", "qdot", "velocity", "vel", "speed", "omega"},
    "acceleration": {"ddq", "qdd", "acceleration", "acc"},
    "torque": {"tau", "torque", "effort", "moment", "trq", "load"},
    "current": {"current", "cur", "curr", "amp", "amps", "i", "iq"},
    "temperature": {"temperature", "temp"},
    "time": {"t", "time", "timestamp", "stamp", "sec", "secs", "seconds"},
}
"""Words for a quantity; the first match in this order counts."""
STATES = {"state", "action"}
"""Those of them that are positions if nothing else is said."""
REFERENCE = {
    "ref",
    "reference",
    "target",
    "desired",
    "des",
    "d",
    "cmd",
    "cmptd",
    "command",
    "commanded",
    "setpoint",
    "goal",
    "action",
    "control",
}
"""Words for what was asked for, in place of what was measured."""
SENSOR = {"sensor", "sm", "ft"}
"""Words for a joint torque sensor."""
NOT_OF_JOINTS = {
    "tcp",
    "cartesian",
    "pose",
    "wrench",
    "ext",
    "external",
    "error",
    "digital",
    "analog",
    "mode",
    "status",
}
"""Words for what is not a quantity of the joints, or a difference of two."""


@dataclass(frozen=True)
class Meaning:
    """What a column holds by its name.

    Attributes:
        quantity: a key of ``QUANTITIES``, or empty if the name does not say.
        reference: whether it was asked for, in place of measured.
        sensor: whether a joint torque sensor is named.
        words: of the name, lower case.
    """

    quantity: str
    reference: bool
    sensor: bool
    words: frozenset[str]


def meaning_of(name: str, context: str = "") -> Meaning:
    """Meaning of the name of a column or of a group's pattern.

    Args:
        name: of the column.
        context: name of the table that holds it, or of its file; counts if the column's own name is silent.

    >>> meaning_of("target_qd_{j0}").quantity, meaning_of("target_qd_{j0}").reference
    ('velocity', True)
    """
    own = words_of(name)
    around = words_of(context)
    # a state may hold other quantities than positions, which then say so
    found = _quantity(own - STATES) or _quantity(own) or _quantity(around)
    if own & NOT_OF_JOINTS:
        found = ""
    asked = bool(own & REFERENCE) or (
        bool(around & REFERENCE) and not own & {"actual", "measured", "feedback"}
    )
    return Meaning(found, asked, bool(own & SENSOR), frozenset(own))


def words_of(name: str) -> set[str]:
    """Words of a name, lower case, in the singular: PositionCmptd1 and position_cmptd have the same two."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"\{\w+\}", " ", name))
    words = re.split(r"[^a-z]+", spaced.lower())
    return {_singular(word) for word in words} - {""}


def _singular(word: str) -> str:
    if word.endswith("ies"):
        return word[:-3] + "y"
    plural = len(word) > 3 and word.endswith("s") and not word.endswith(("us", "ss"))
    return word[:-1] if plural else word


def _quantity(words: set[str]) -> str:
    for quantity, names in QUANTITIES.items():
        if words & names:
            return quantity
    return ""


# Units of positions and velocities, from their names, their range and each other.


ANGLES = ("rad", "deg", "rev")
SPEEDS = ("rad/s", "deg/s", "rpm", "step/s")
FARTHEST = 7.0
"""Position beyond which an arm's joint has made more than a turn if it is in radians [rad]."""
LARGEST = 1e9
"""Value that no quantity of a joint reaches, in any unit."""
ALIKE = 0.1
"""Units fit if velocity over derivative of the position is as they say within this share [1]."""

Guess = tuple[str, str]
"""A unit of the import section, and what the guess rests on."""


def position_unit(name: str, positions: np.ndarray, moved: float | None) -> Guess:
    """Unit of positions, (N, k).

    Args:
        name: of the columns.
        positions: as they are in the log.
        moved: velocity over derivative of the position [1], if a velocity is there.
    """
    said = _said(name, ANGLES)
    if said:
        return said, "its name says so"
    reach = float(np.nanmax(np.abs(positions)))
    if reach <= FARTHEST:
        return "rad", f"it reaches {reach:.3g}, less than a turn"
    if reach <= 100.0 and "observation" in words_of(name):
        why = "degrees, or LeRobot's normalised -100 to 100: then unit: normalised, and calibration: with its file"
        return "deg", f"it reaches {reach:.3g}: {why}"
    if reach <= 400.0:
        return "deg", f"it reaches {reach:.3g}, more than a turn in radians"
    if reach < STEPS_PER_TURN and not (positions % 1).any():
        return (
            "step",
            f"whole numbers up to {reach:.4g}: of {STEPS_PER_TURN} steps a turn",
        )
    reason = f"it reaches {reach:.3g}: the motor's side, or counts of an encoder"
    return "rad", reason + (
        "" if moved is None else f"; velocity is {moved:.3g} of its derivative"
    )


def velocity_unit(name: str, angle: str, moved: float | None) -> Guess:
    """Unit of velocities.

    Args:
        name: of the columns.
        angle: unit of the positions.
        moved: velocity over derivative of the position, both as in the log [1], or ``None``.
    """
    said = _said(name, SPEEDS)
    if said:
        return said, "its name says so"
    same = {"rad": "rad/s", "deg": "deg/s", "rev": "rpm", "step": "step/s"}[angle]
    if moved is None:
        return same, "taken as that of the position; it does not follow its derivative"
    fitting = {unit: abs(moved * UNITS[unit] / UNITS[angle] - 1) for unit in SPEEDS}
    best = min(fitting, key=lambda unit: fitting[unit])
    if fitting[best] < ALIKE:
        return best, f"it is {moved:.3g} times the derivative of the position"
    return (
        same,
        f"it is {moved:.3g} times the derivative of the position, as no unit has it",
    )


def derivative_ratio(
    t: np.ndarray, positions: np.ndarray, velocities: np.ndarray
) -> float | None:
    """Velocity over derivative of the position, median over the joints that move and agree in shape; or ``None``.

    Args:
        t: time [s], (N,).
        positions, velocities: (N, n), in any unit.
    """
    width = min(positions.shape[1], velocities.shape[1])
    span = t[2:] - t[:-2]
    usable = span > 0
    ratios = []
    for j in range(width):
        slope = (positions[2:, j] - positions[:-2, j])[usable] / span[usable]
        speed = velocities[1:-1, j][usable]
        numbers = (np.abs(slope) < LARGEST) & (np.abs(speed) < LARGEST)
        slope, speed = slope[numbers], speed[numbers]
        power = float(slope @ slope)
        scale = np.sqrt(power * float(speed @ speed))
        if scale > 0 and abs(float(slope @ speed)) / scale > 0.9:
            ratios.append(float(slope @ speed) / power)
    return float(np.median(ratios)) if ratios else None


def _said(name: str, units: tuple[str, ...]) -> str | None:
    """The unit that the name of a column states."""
    words = words_of(name)
    degrees = words & {"deg", "degree"}
    for unit in units:
        base = unit.split("/")[0]
        if base in words or (base == "deg" and degrees):
            return unit
    return None


# Columns that belong together: one number for each joint.


_BRACKETED = re.compile(r"^.*\[(?P<label>[^\[\]]+)\][^\[\]]*$")
_FIELD = re.compile(r"^.*\[(?P<label>[^\[\].]+)\.(?P<field>[^\[\]]+)\]$")
_NUMBERED = re.compile(r"^.*?(?P<label>\d+)\D*$")
_DOTTED = re.compile(r"^(?P<label>[^.]+)\..+$")
"""Names of columns in which a joint stands in brackets, there before a quantity, is a number (the last), or stands
before a dot."""


SMOOTHER = 0.5
"""Share of its way that a series keeps if what seemed its leaps were a change of sign [1]. (hand)"""


BY_NAME = "by its name"
"""Reason for columns of which only the name tells the channel."""


@dataclass(frozen=True)
class ColumnGroup:
    """Columns with one number for each of k joints, or one column whose cells hold lists.

    Attributes:
        pattern: name with ``{j}`` (numbered from 1), ``{j0}`` (from 0) or ``{joint}`` in the place of what differs;
            the name itself of a column of lists, and of a single column.
        labels: what stands in that place, k texts; numbers from 1 for a column of lists.
        names: of the columns; one for a column of lists.
        values: (N, k); nan if a cell is empty or no number.
        seen: what their values show, of columns whose names tell nothing.
        holds: what these hold by that, in words that ``meaning_of`` knows; empty if names tell.
        sign_bit: bit of the numbers in the file that says the sign of these; ``None`` for ordinary numbers.
    """

    pattern: str
    labels: tuple[str, ...]
    names: tuple[str, ...]
    values: np.ndarray
    seen: str = ""
    holds: str = ""
    sign_bit: int | None = None

    @property
    def width(self) -> int:
        """Number of columns k, or of the entries of each list."""
        return self.values.shape[1]

    @property
    def numbered(self) -> bool:
        """Whether the columns have numbers in place of names."""
        return all(name.isdecimal() for name in self.names)

    def meaning(self, context: str) -> Meaning:
        """What they hold, by their values or their names; the name of file and topic counts if these are silent."""
        return meaning_of(self.holds or self.pattern, context)

    @property
    def by_name(self) -> bool:
        """Whether names of joints tell the columns apart."""
        return "{joint}" in self.pattern


@dataclass(frozen=True)
class TableColumns:
    """The columns of one table, sorted.

    Attributes:
        groups: one number for each joint.
        singles: other columns of numbers, (N,) each.
        texts: names of columns that hold no numbers.
    """

    groups: tuple[ColumnGroup, ...]
    singles: Mapping[str, np.ndarray]
    texts: tuple[str, ...]


def sorted_columns(table: Table, joints: Sequence[str] = ()) -> TableColumns:
    """Columns of a table as groups, single numbers and texts.

    Args:
        table: as a reader gave it.
        joints: names of joints that are known, which columns may carry.
    """
    numbers: dict[str, np.ndarray] = {}
    groups: list[ColumnGroup] = []
    texts = []
    for name, cells in table.columns.items():
        values = numbers_of(cells)
        if values is None:
            texts.append(name)
        elif values.ndim == 2:
            labels = tuple(str(k + 1) for k in range(values.shape[1]))
            groups.append(ColumnGroup(name, labels, (name,), values))
        else:
            numbers[name] = values
    for pattern, members in _patterns(list(numbers), joints).items():
        labels, names = tuple(members), tuple(members.values())
        values = np.column_stack([numbers.pop(name) for name in names])
        groups.append(ColumnGroup(_counted(pattern, labels), labels, names, values))
    return TableColumns(tuple(map(_signed, groups)), numbers, tuple(texts))


def _signed(group: ColumnGroup) -> ColumnGroup:
    """A group with its signs, if whole numbers run on through zero once a bit is read as the sign."""
    values = group.values
    if not np.isfinite(values).all() or (values < 0).any() or (values % 1).any():
        return group
    rough = np.abs(np.diff(values, axis=0)).sum()
    for bit in SIGN_BITS:
        if 2**bit <= values.max(initial=0) < 2 ** (bit + 1):
            read = with_sign(values, bit)
            if np.abs(np.diff(read, axis=0)).sum() < SMOOTHER * rough:
                return replace(group, values=read, sign_bit=bit)
    return group


def numbers_of(cells: Any) -> np.ndarray | None:
    """Cells as numbers, (N,), or (N, k) if they hold lists; ``None`` for texts."""
    first = next((cell for cell in cells if cell is not None and cell != ""), None)
    if isinstance(first, str) and first.lstrip().startswith("["):
        try:
            return _lists([json.loads(cell) for cell in cells])
        except ValueError:
            return None
    if isinstance(first, (list, tuple, np.ndarray)):
        return _lists(cells)
    try:
        return np.asarray(cells, dtype=float)
    except (ValueError, TypeError):
        pass
    parsed = np.array([_number(cell) for cell in cells])
    # a few empty or broken cells do not make a text of a column
    return parsed if np.isfinite(parsed).mean() > 0.5 else None


def _lists(cells: Any) -> np.ndarray | None:
    """Lists of one length as (N, k)."""
    lengths = {np.shape(cell) for cell in cells}
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        return None
    return np.array([np.asarray(cell, dtype=float) for cell in cells])


def _number(cell: Any) -> float:
    try:
        return float(cell)
    except (ValueError, TypeError):
        return np.nan


def _patterns(names: Sequence[str], joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Names of columns by pattern, then by what stands in the place of ``{joint}``, if that differs among them."""
    readings = {name: _readings(name, joints) for name in names}
    counts = Counter(pattern for read in readings.values() for pattern, _ in read)
    found: dict[str, dict[str, str]] = {}
    for name, read in readings.items():
        # the pattern that most columns share; the first of several
        pattern, label = max(read, key=lambda r: counts[r[0]], default=("", ""))
        if counts[pattern] > 1 or label in joints:
            found.setdefault(pattern, {})[label] = name
    return {
        pattern: dict(sorted(members.items(), key=_by_number))
        for pattern, members in found.items()
    }


def _readings(name: str, joints: Sequence[str]) -> list[tuple[str, str]]:
    """Each way to read the name of a column as that of a joint's: pattern, and what stands for ``{joint}``."""
    # the longest first: joint_1 is a part of joint_10
    for joint in sorted(joints, key=len, reverse=True):
        if joint in name:
            return [(name.replace(joint, "{joint}", 1), joint)]
    field = _FIELD.match(name)
    if field and meaning_of(field["field"]).quantity:
        start, end = field.span("label")
        return [(f"{name[:start]}{{joint}}{name[end:]}", field["label"])]
    found = []
    for form in (_BRACKETED, _NUMBERED, _DOTTED):
        match = form.match(name)
        if match:
            start, end = match.span("label")
            found.append((f"{name[:start]}{{joint}}{name[end:]}", match["label"]))
    return found


def _by_number(member: tuple[str, str]) -> float:
    """Order of columns that are numbered; others keep the file's."""
    return int(member[0]) if member[0].isdigit() else 0


def _counted(pattern: str, labels: tuple[str, ...]) -> str:
    """The pattern with ``{j}`` or ``{j0}`` if the labels are numbers that count from 1 or 0."""
    for first, place in ((1, "{j}"), (0, "{j0}")):
        if labels == tuple(str(first + k) for k in range(len(labels))):
            return pattern.replace("{joint}", place)
    return pattern


# The time of a log: which column, in which unit, or at which rate.


TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
USUAL_RATES = (
    30,
    50,
    60,
    100,
    125,
    200,
    240,
    250,
    400,
    500,
    800,
    1000,
    2000,
    4000,
    5000,
    8000,
)
"""Rates at which arms are logged [Hz]; a measured rate within 3 % of one is taken as that."""
FALLBACK_RATE = 100.0
"""Rate that a case is drafted with if nothing in the log tells it [Hz]."""


@dataclass(frozen=True)
class TimeGuess:
    """Where the time stands.

    Attributes:
        column: name, or ``None`` if there is none.
        unit: of the column; empty if it counts samples or there is none.
        rate: median rate [Hz], of the stamps or, if they tell none, as guessed.
        seconds: (N,), from 0.
        why: what the guess rests on.
        start: time of the first row on the clock of the log [s].
        certain: whether the log itself tells the rate.
    """

    column: str | None
    unit: str
    rate: float
    seconds: np.ndarray
    why: str
    start: float = 0.0
    certain: bool = True


def guess_time(
    singles: Mapping[str, np.ndarray],
    rows: np.ndarray,
    position: np.ndarray | None,
    velocity: np.ndarray | None,
) -> TimeGuess:
    """Time of a table with N rows.

    Args:
        singles: columns of numbers that belong to no joint, (N,) each.
        rows: their numbers in the file, (N,).
        position, velocity: what is taken for q and dq, (N, n), in any unit; their ratio tells the rate if the
            column counts samples or there is none.
    """
    named = [name for name in singles if meaning_of(name).quantity == "time"]
    rising = [name for name in singles if runs_forward(singles[name])]
    for name in [*(n for n in named if n in rising), *named, *rising]:
        stamps = singles[name]
        if not np.isfinite(stamps).all():
            continue
        if counts_rows(stamps):
            return _by_rows(name, rows, position, velocity)
        guess = _stamped(name, stamps)
        if guess is not None:
            return guess
    return _by_rows(None, rows, position, velocity)


def runs_forward(stamps: np.ndarray) -> bool:
    """Whether numbers never fall and mostly rise."""
    step = np.diff(stamps)
    return bool(len(step) and (step >= 0).all() and (step > 0).mean() > 0.8)


def counts_rows(stamps: np.ndarray) -> bool:
    """Whether a column counts rows: whole numbers that rise by one."""
    step = np.diff(stamps)
    return (
        bool(len(step))
        and float(np.median(step)) == 1.0
        and bool((step == np.round(step)).all())
    )


def _stamped(name: str, stamps: np.ndarray) -> TimeGuess | None:
    """The unit in which stamps make a rate that robots are logged at; seconds first, but for what the name says."""
    step = np.diff(stamps)
    if not (step > 0).any():
        return None
    median = float(np.median(step[step > 0]))
    likely = unit_of_stamps(1.0 / median, float(stamps[-1] - stamps[0]))
    said = [unit for unit in TIME_UNITS if name.lower().endswith(f"_{unit}")]
    if said and unit_of_stamps(1.0 / (median * TIME_UNITS[said[0]]), np.inf) == "s":
        likely = said[0]
    # of what is called a time, but too slow in any unit, the reader says so
    unit = likely or ("s" if meaning_of(name).quantity == "time" else "")
    if not unit:
        return None
    factor = TIME_UNITS[unit]
    rate = 1.0 / (median * factor)
    seconds = (stamps - stamps[0]) * factor
    why = f"its steps in {unit} make {rate:.4g} Hz"
    return TimeGuess(name, unit, rate, seconds, why, float(stamps[0]) * factor)


def _by_rows(
    column: str | None,
    rows: np.ndarray,
    position: np.ndarray | None,
    velocity: np.ndarray | None,
) -> TimeGuess:
    """Time from the number of the row, with the rate at which the velocity is the derivative of the position."""
    what = "the column counts rows" if column else "there is no column of time"
    rate, certain = FALLBACK_RATE, False
    why = f"{what}, and nothing in the log tells the rate: look it up"
    if position is not None and velocity is not None:
        # per row in place of per second, the ratio is the rate
        found = derivative_ratio(rows, position, velocity)
        if found is not None and found > 0:
            rate, certain = _usual(found), True
            why = f"{what}; the velocity is the derivative of the position at {found:.4g} Hz"
    seconds = (rows - rows[:1]) / rate
    return TimeGuess(column, "", rate, seconds, why, certain=certain)


def _usual(rate: float) -> float:
    nearest = min(USUAL_RATES, key=lambda usual: abs(np.log(usual / rate)))
    return float(nearest) if abs(nearest / rate - 1) < 0.03 else float(f"{rate:.4g}")


# Which columns are which channel of a recording.


TORQUE_ORDER = (
    "derived from current",
    "torque",
    "current",
    "commanded torque",
    "commanded current",
)
"""What a torque column may be called, the most useful first."""


AMPERES = ("current", "commanded current")
"""Those of them that are no torque yet."""


@dataclass(frozen=True)
class ChannelGuess:
    """Columns taken for a channel.

    Attributes:
        channel: name of the channel.
        group: the columns.
        unit: of the import section, ``A`` for amperes.
        why: what the guess rests on.
        role: what its vendor says that it holds; of a torque without, an entry of ``TORQUE_ORDER``; else empty.
    """

    channel: str
    group: ColumnGroup
    unit: str
    why: str
    role: str = ""


def position_and_velocity(
    columns: TableColumns, context: str
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Values taken for measured positions and velocities, in any unit, for a guess of the rate."""
    found: dict[str, np.ndarray] = {}
    for group in columns.groups:
        meaning = group.meaning(context)
        if meaning.quantity in ("position", "velocity") and not meaning.reference:
            found.setdefault(meaning.quantity, group.values)
    return found.get("position"), found.get("velocity")


def channels_of_table(
    columns: TableColumns, layout: Layout | None, time: TimeGuess, context: str
) -> list[ChannelGuess]:
    """Every group of columns that may be a channel, best first for each channel.

    Args:
        columns: of the table.
        layout: columns of a known layout that the table has; they come before those told by their names.
        time: of the table.
        context: name of file and topic, which count if the names of the columns are silent.
    """
    named = [(group, group.meaning(context)) for group in columns.groups]
    known = _of_layout(columns, layout)
    found = list(known)
    taken = [guess.group for guess in known]
    for group, meaning in named:
        channel, role = _channel(meaning)
        if channel and not any(group is other for other in taken):
            why = group.seen or BY_NAME
            found.append(ChannelGuess(channel, group, "", why, role))
    positions = _first(found, "q") or _first(found, "q_ref")
    angle, why = "rad", ""
    if positions is not None:
        ratio = _ratio(time, positions, _first(found, "dq"))
        group = positions.group
        angle, why = position_unit(group.pattern, group.values, ratio)
    found = [
        guess if guess.unit else _with_units(guess, angle, why, time, found)
        for guess in found
    ]
    order = {role: rank + 1 for rank, role in enumerate(TORQUE_ORDER)}
    return sorted(found, key=lambda guess: order.get(guess.role, 0))


def _of_layout(columns: TableColumns, layout: Layout | None) -> list[ChannelGuess]:
    """Columns of a known layout, in its order."""
    if layout is None:
        return []
    by_pattern = {group.pattern: group for group in columns.groups}
    found = []
    for channel, places in layout.places.items():
        for place in places:
            group = by_pattern.get(place.column)
            if group is not None:
                why = f"as in {layout.name}"
                found.append(ChannelGuess(channel, group, place.unit, why, place.holds))
    return found


def _channel(meaning: Meaning) -> tuple[str, str]:
    """Channel, and for a torque its role; empty for columns that are none."""
    suffix = "_ref" if meaning.reference else ""
    if meaning.quantity in ("position", "velocity"):
        return {"position": "q", "velocity": "dq"}[meaning.quantity] + suffix, ""
    if meaning.quantity == "temperature":
        return "temperature", ""
    if meaning.quantity == "torque":
        if meaning.sensor:
            return "tau_sensor", ""
        if meaning.reference:
            return "tau", "commanded torque"
        by_current = meaning.words & {"cur", "current"}
        return "tau", "derived from current" if by_current else "torque"
    if meaning.quantity == "current":
        return "tau", "commanded current" if meaning.reference else "current"
    return "", ""


def _with_units(
    guess: ChannelGuess,
    angle: str,
    why: str,
    time: TimeGuess,
    others: Sequence[ChannelGuess],
) -> ChannelGuess:
    """A guess with the unit of its columns."""
    unit, reason = "N m", ""
    if guess.channel in ("q", "q_ref"):
        unit, reason = angle, why
    elif guess.channel in ("dq", "dq_ref"):
        positions = _first(others, guess.channel[1:]) or _first(others, "q")
        ratio = _ratio(time, positions, guess)
        unit, reason = velocity_unit(guess.group.pattern, angle, ratio)
    elif guess.channel == "temperature":
        unit = "degC"
    elif guess.role in AMPERES:
        unit = "A"
    # a name that says what the channel is says little beside what the values show
    said = "" if reason and guess.why == BY_NAME else guess.why
    return replace(guess, unit=unit, why="; ".join(filter(None, (said, reason))))


def _ratio(
    time: TimeGuess, positions: ChannelGuess | None, velocities: ChannelGuess | None
) -> float | None:
    if positions is None or velocities is None:
        return None
    return derivative_ratio(
        time.seconds, positions.group.values, velocities.group.values
    )


def _first(found: Sequence[ChannelGuess], channel: str) -> ChannelGuess | None:
    return next((guess for guess in found if guess.channel == channel), None)
