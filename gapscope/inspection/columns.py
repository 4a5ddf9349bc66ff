"""Columns of a log: their words and units, one number for each joint, their time, and which channel they are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.layouts import STEPS_PER_TURN, UNITS, Layout, with_sign
from gapscope.arm.io.plausibility import unit_of_stamps
from gapscope.arm.io.table import BEYOND, Table
from gapscope.arm.nominal import NominalArm

# Units and words of an inspection.


SIGN_BITS = (10, 15)
"""Bits in which Feetech servos keep the sign of a load, and of a speed; the lower ones hold the magnitude."""

# What the name of a column says that it holds.


_WORDS = yaml.safe_load(
    Path(__file__).with_name("words.yaml").read_text(encoding="utf-8")
)
QUANTITIES = {name: set(words) for name, words in _WORDS["quantities"].items()}
"""Words for a quantity; the first match in this order counts."""
STATES, REFERENCE, SENSOR, NOT_OF_JOINTS = (
    set(_WORDS[name]) for name in ("states", "reference", "sensor", "not_of_joints")
)
"""Those of them that are positions if nothing else is said; for what was asked for, in place of what was measured; for
a joint torque sensor; for what is not a quantity of the joints, or a difference of two."""


@dataclass(frozen=True)
class Meaning:
    """What a column holds by its name.

    Attributes:
        quantity: a key of ``QUANTITIES``, or empty if the name does not say.
        reference: whether it was asked for, in place of measured.
        words: of the name, lower case.
    """

    quantity: str
    reference: bool
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
    return Meaning(found, asked, frozenset(own))


def words_of(name: str) -> set[str]:
    """Words of a name, lower case, in the singular: PositionCmptd1 and position_cmptd have the same two."""
    # PositionCmptd1 at its capitals; what stands in braces is no word
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"\{\w+\}", " ", name))
    words = re.findall("[a-z]+", spaced.lower())
    singular = (re.sub("ies$", "y", word) for word in words)
    # pos, status and class are no plurals
    return {re.sub("(?<=..[^us])s$", "", word) for word in singular}


def _quantity(words: set[str]) -> str:
    fitting = (name for name, known in QUANTITIES.items() if words & known)
    return next(fitting, "")


# Units of positions and velocities, from their names, their range and each other.


ANGLES = ("rad", "deg", "rev")
SPEEDS = ("rad/s", "deg/s", "rpm", "step/s")
FARTHEST = 7.0
"""Position beyond which an arm's joint has made more than a turn if it is in radians [rad]."""
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
    # what is written goes before what values suggest
    said = _said(name, ANGLES)
    if said:
        return said, "its name says so"
    reach = float(np.nanmax(np.abs(positions)))
    # up to a turn and a little, as nearly all arms move
    if reach <= FARTHEST:
        return "rad", f"it reaches {reach:.3g}, less than a turn"
    if reach <= 100.0 and "observation" in words_of(name):
        why = "degrees, or LeRobot's normalised -100 to 100: then unit: normalised, and calibration: with its file"
        return "deg", f"it reaches {reach:.3g}: {why}"
    if reach <= 400.0:
        return "deg", f"it reaches {reach:.3g}, more than a turn in radians"
    # whole numbers within a turn of a servo's encoder
    if reach < STEPS_PER_TURN and not (positions % 1).any():
        return (
            "step",
            f"whole numbers up to {reach:.4g}: of {STEPS_PER_TURN} steps a turn",
        )
    reason = f"it reaches {reach:.3g}: the motor's side, or counts of an encoder"
    if moved is not None:
        reason += f"; velocity is {moved:.3g} of its derivative"
    return "rad", reason


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
    why = f"it is {moved:.3g} times the derivative of the position"
    # the unit in which the velocity is the derivative of the position
    off, best = min(
        (abs(moved * UNITS[unit] / UNITS[angle] - 1), unit) for unit in SPEEDS
    )
    return (best, why) if off < ALIKE else (same, f"{why}, as no unit has it")


def derivative_ratio(
    t: np.ndarray, positions: np.ndarray, velocities: np.ndarray
) -> float | None:
    """Velocity over derivative of the position, median over the joints that move and agree in shape; or ``None``.

    Args:
        t: time [s], (N,).
        positions, velocities: (N, n), in any unit.
    """
    width = min(positions.shape[1], velocities.shape[1])
    # central differences are neither early nor late against the velocity
    span = t[2:] - t[:-2]
    usable = span > 0
    ratios = []
    for j in range(width):
        slope = (positions[2:, j] - positions[:-2, j])[usable] / span[usable]
        speed = velocities[1:-1, j][usable]
        numbers = (np.abs(slope) < BEYOND) & (np.abs(speed) < BEYOND)
        slope, speed = slope[numbers], speed[numbers]
        power = float(slope @ slope)
        scale = np.sqrt(power * float(speed @ speed))
        # a joint that rests, or a column that is something else, has no say
        if scale > 0 and abs(float(slope @ speed)) / scale > 0.9:
            ratios.append(float(slope @ speed) / power)
    return float(np.median(ratios)) if ratios else None


def _said(name: str, units: tuple[str, ...]) -> str | None:
    """The unit that the name of a column states."""
    words = words_of(name)
    degrees = words & {"deg", "degree"}
    for unit in units:
        # a name says rad for rad/s: its words have no slash
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


@dataclass(frozen=True, eq=False)
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


TableColumns = tuple[tuple[ColumnGroup, ...], Mapping[str, np.ndarray]]
"""The columns of one table: groups of one number for each joint, and other columns of numbers, (N,) each, by name."""


def sorted_columns(table: Table, joints: Sequence[str] = ()) -> TableColumns:
    """Columns of a table as groups and single numbers.

    Args:
        table: as a reader gave it.
        joints: names of joints that are known, which columns may carry.
    """
    every = _numbers(table)
    numbers = {name: x for name, x in every.items() if x.ndim == 1}
    groups = [
        ColumnGroup(name, tuple(map(str, range(1, x.shape[1] + 1))), (name,), x)
        for name, x in every.items()
        if x.ndim == 2
    ]
    for pattern, members in _patterns(list(numbers), joints).items():
        labels, names = tuple(members), tuple(members.values())
        values = np.column_stack([numbers.pop(name) for name in names])
        groups.append(ColumnGroup(_counted(pattern, labels), labels, names, values))
    return tuple(map(_signed, groups)), numbers


def _signed(group: ColumnGroup) -> ColumnGroup:
    """A group with its signs, if whole numbers run on through zero once a bit is read as the sign."""
    values = group.values
    if not np.isfinite(values).all() or (values < 0).any() or (values % 1).any():
        return group
    # a sign that is read as magnitude makes a leap at each passage of zero
    rough = np.abs(np.diff(values, axis=0)).sum()
    for bit in SIGN_BITS:
        # the highest bit that is set is the sign's
        if 2**bit <= values.max(initial=0) < 2 ** (bit + 1):
            read = with_sign(values, bit)
            if np.abs(np.diff(read, axis=0)).sum() < SMOOTHER * rough:
                return replace(group, values=read, sign_bit=bit)
    return group


def _numbers(table: Table) -> dict[str, np.ndarray]:
    """Columns of numbers, (N,), or of lists of numbers, (N, k), by their names; texts are left out."""
    found = {name: table.values(name) for name in table.columns}
    # a few empty or broken cells do not make a text of a column
    return {name: x for name, x in found.items() if np.isfinite(x).mean() > 0.5}


def _patterns(names: Sequence[str], joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Names of columns by pattern, then by what stands in the place of ``{joint}``, if that differs among them."""
    readings = {name: _readings(name, joints) for name in names}
    counts = Counter(pattern for read in readings.values() for pattern, _ in read)
    found: dict[str, dict[str, str]] = {}
    for name, read in readings.items():
        # the pattern that most columns share; the first of several
        pattern, label = max(read, key=lambda r: counts[r[0]], default=("", ""))
        # single columns count as one joint if they carry its name
        if counts[pattern] > 1 or label in joints:
            found.setdefault(pattern, {})[label] = name
    # columns that are numbered in their order, others in the file's
    return {
        pattern: dict(
            sorted(members.items(), key=lambda x: int(x[0]) if x[0].isdigit() else 0)
        )
        for pattern, members in found.items()
    }


def _readings(name: str, joints: Sequence[str]) -> list[tuple[str, str]]:
    """Each way to read the name of a column as that of a joint's: pattern, and what stands for ``{joint}``."""
    # the longest first: joint_1 is a part of joint_10
    for joint in sorted(joints, key=len, reverse=True):
        if joint in name:
            return [(name.replace(joint, "{joint}", 1), joint)]
    # position[joint_1.x]: what stands before the dot is the joint
    field = _FIELD.match(name)
    matches = [form.match(name) for form in (_BRACKETED, _NUMBERED, _DOTTED)]
    if field and meaning_of(field["field"]).quantity:
        matches = [field]
    return [
        (f"{name[: m.start('label')]}{{joint}}{name[m.end('label') :]}", m["label"])
        for m in matches
        if m
    ]


def _counted(pattern: str, labels: tuple[str, ...]) -> str:
    """The pattern with ``{j}`` or ``{j0}`` if the labels are numbers that count from 1 or 0."""
    for first, place in ((1, "{j}"), (0, "{j0}")):
        if labels == tuple(str(first + k) for k in range(len(labels))):
            return pattern.replace("{joint}", place)
    return pattern


# The time of a log: which column, in which unit, or at which rate.


TIME_UNITS = ("s", "ms", "us", "ns")
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
        certain: whether the log itself tells the rate.
    """

    column: str | None
    unit: str
    rate: float
    seconds: np.ndarray
    why: str
    certain: bool = True


def guess_time(columns: TableColumns, rows: np.ndarray, context: str) -> TimeGuess:
    """Time of a table.

    Args:
        columns: of the table; the ratio of what is taken for measured velocities and positions, in any unit, tells the
            rate if the column of time counts samples or there is none.
        rows: their numbers in the file, (N,).
        context: name of file and topic.
    """
    groups, singles = columns
    named = [name for name in singles if meaning_of(name).quantity == "time"]
    rising = [name for name in singles if runs_forward(singles[name])]
    counted = None
    # what is called time and rises, what is called so, what only rises
    for name in [*(n for n in named if n in rising), *named, *rising]:
        stamps = singles[name]
        if not np.isfinite(stamps).all():
            continue
        # numbers of rows tell no rate: look for it elsewhere; steps of one may be milliseconds
        if counts_rows(stamps) and not name.lower().endswith("_ms"):
            counted = name
            break
        step = np.diff(stamps)
        if not (step > 0).any():
            continue
        # the unit in which stamps make a rate that robots are logged at; seconds first, but for what the name says
        median = float(np.median(step[step > 0]))
        likely = unit_of_stamps(1.0 / median, float(stamps[-1] - stamps[0]))
        for said in TIME_UNITS:
            fits = unit_of_stamps(1.0 / (median * UNITS[said]), np.inf) == "s"
            likely = said if name.lower().endswith(f"_{said}") and fits else likely
        # of what is called a time, but too slow in any unit, the reader says so
        unit = likely or ("s" if name in named else "")
        if unit:
            rate = 1.0 / (median * UNITS[unit])
            seconds = (stamps - stamps[0]) * UNITS[unit]
            why = f"its steps in {unit} make {rate:.4g} Hz"
            return TimeGuess(name, unit, rate, seconds, why)
    # by the number of the row, with the rate at which the velocity is the derivative of the position
    motion: dict[str, np.ndarray] = {}
    for group in groups:
        meaning = group.meaning(context)
        if not meaning.reference:
            # the first group of each quantity that was measured
            motion.setdefault(meaning.quantity, group.values)
    what = "the column counts rows" if counted else "there is no column of time"
    rate, found = FALLBACK_RATE, None
    why = f"{what}, and nothing in the log tells the rate: look it up"
    if "position" in motion and "velocity" in motion:
        # per row in place of per second, the ratio is the rate
        found = derivative_ratio(rows, motion["position"], motion["velocity"])
    certain = found is not None and found > 0
    if found is not None and certain:
        rate = float(f"{found:.4g}")
        nearest = min(USUAL_RATES, key=lambda usual: abs(np.log(usual / rate)))
        # a rate in use, if it is near one: the rest is noise of the derivative
        if abs(nearest / found - 1) < 0.03:
            rate = float(nearest)
        why = (
            f"{what}; the velocity is the derivative of the position at {found:.4g} Hz"
        )
    return TimeGuess(counted, "", rate, (rows - rows[:1]) / rate, why, certain)


def runs_forward(stamps: np.ndarray) -> bool:
    """Whether numbers never fall and mostly rise."""
    step = np.diff(stamps)
    return bool(len(step) and (step >= 0).all() and (step > 0).mean() > 0.8)


def counts_rows(stamps: np.ndarray) -> bool:
    """Whether a column counts rows: whole numbers that rise by one."""
    step = np.diff(stamps)
    whole = bool(len(step)) and bool((step == np.round(step)).all())
    return whole and float(np.median(step)) == 1.0


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


@dataclass(frozen=True, eq=False)
class ChannelGuess:
    """Columns taken for a channel.

    Attributes:
        channel: name of the channel.
        group: the columns.
        unit: of the import section, ``A`` for amperes.
        why: what the guess rests on.
        role: what its vendor says that it holds; of a torque without, an entry of ``TORQUE_ORDER``; else empty.
        facts: what a torque can be, in sentences.
    """

    channel: str
    group: ColumnGroup
    unit: str
    why: str
    role: str = ""
    facts: tuple[str, ...] = ()

    @property
    def reason(self) -> str:
        """Why the columns are taken for what they are."""
        said: tuple[str, ...] = (self.why, self.role)
        if self.channel in ("tau", "tau_sensor"):
            silent = self.group.seen or not self.role
            said = (self.why if silent else self.role, *self.facts)
        return "; ".join(filter(None, said))


def first_of_each(guesses: Sequence[ChannelGuess]) -> dict[str, ChannelGuess]:
    """The first columns taken for each channel, by its name."""
    # reversed: the first of each channel stays
    return {guess.channel: guess for guess in reversed(guesses)}


def channels_of_table(
    groups: Sequence[ColumnGroup], layout: Layout | None, time: TimeGuess, context: str
) -> list[ChannelGuess]:
    """Every group of columns that may be a channel, best first for each channel.

    Args:
        groups: columns of the table.
        layout: columns of a known layout that the table has; they come before those told by their names.
        time: of the table.
        context: name of file and topic, which count if the names of the columns are silent.
    """
    by_pattern = {group.pattern: group for group in groups}
    found = []
    # the vendor's word first: what columns mean is then known
    for channel, places in ({} if layout is None else layout.places).items():
        for place in places:
            group = by_pattern.get(place.column)
            if group is not None:
                why = f"as in {layout.name}" if layout else ""
                found.append(ChannelGuess(channel, group, place.unit, why, place.holds))
    taken = {guess.group.pattern for guess in found}
    for group in groups:
        channel, role = _channel(group.meaning(context))
        # what the layout has taken is no other channel
        if channel and group.pattern not in taken:
            why = group.seen or BY_NAME
            found.append(ChannelGuess(channel, group, "", why, role))
    first = {name: guess.group for name, guess in first_of_each(found).items()}
    # references alone say the unit of positions as well
    positions = first.get("q", first.get("q_ref"))

    def ratio(
        position: ColumnGroup | None, velocity: ColumnGroup | None
    ) -> float | None:
        """Velocity over derivative of the position, if both are there."""
        if position is None or velocity is None:
            return None
        return derivative_ratio(time.seconds, position.values, velocity.values)

    angle, angle_why = "rad", ""
    if positions is not None:
        moved = ratio(positions, first.get("dq"))
        angle, angle_why = position_unit(positions.pattern, positions.values, moved)

    def with_unit(guess: ChannelGuess) -> ChannelGuess:
        """A guess with the unit of its columns."""
        unit, reason = "degC" if guess.channel == "temperature" else "N m", ""
        if guess.unit:
            return guess
        if guess.channel in ("q", "q_ref"):
            unit, reason = angle, angle_why
        elif guess.channel in ("dq", "dq_ref"):
            # velocity of the reference against the reference, if it is there
            moved = ratio(first.get(guess.channel[1:], first.get("q")), guess.group)
            unit, reason = velocity_unit(guess.group.pattern, angle, moved)
        elif guess.role in AMPERES:
            unit = "A"
        # a name that says what the channel is says little beside what the values show
        said = "" if reason and guess.why == BY_NAME else guess.why
        return replace(guess, unit=unit, why="; ".join(filter(None, (said, reason))))

    # torques by their use, those that never change last; all else stays as it was found
    order = {role: rank + 1 for rank, role in enumerate(TORQUE_ORDER)}

    def use(guess: ChannelGuess) -> tuple[bool, int]:
        """What makes a torque less useful than another one."""
        still = guess.channel == "tau" and not np.ptp(guess.group.values, axis=0).any()
        return still, order.get(guess.role, 0)

    return sorted(map(with_unit, found), key=use)


def _channel(meaning: Meaning) -> tuple[str, str]:
    """Channel, and for a torque its role; empty for columns that are none."""
    asked, quantity = meaning.reference, meaning.quantity
    if quantity in ("position", "velocity"):
        return ("q" if quantity == "position" else "dq") + "_ref" * asked, ""
    if quantity == "torque" and meaning.words & SENSOR:
        return "tau_sensor", ""
    if quantity == "torque" and not asked and meaning.words & {"cur", "current"}:
        return "tau", "derived from current"
    if quantity in ("torque", "current"):
        return "tau", f"commanded {quantity}" if asked else quantity
    return ("temperature", "") if quantity == "temperature" else ("", "")


# Columns whose names tell nothing, told apart by what they hold: time, and blocks of one number for each joint.
#
# A block is the derivative of another if, over ten rows, what the one gains is the mean of the other times the same
# factor on all joints. What has a derivative in the log and is none itself is a position; of two positions that are
# alike the measured one comes later than its reference. Without a derivative in the log, positions are the smoothest
# columns that stay within the limits of the robot. What is left may be a torque; a nominal arm says which explains
# best.


SPAN = 10
"""Rows over which a block is compared with the sum of another [1]: noise of single rows is averaged."""
FOLLOWS = 0.9
"""Cosine between both from which a column is the derivative of another [1]."""
PROPORTIONAL = 0.999
"""Correlation from which a column that rises counts the same time as another [1]: rows may be lost."""
UNEVEN = 0.2
"""Steps of a column of time leave their median by less, in the mean [1]."""
LOST = 1.5
"""Steps of time longer than this many usual ones have lost rows in them [1]."""
ROWS = 50_000
"""Rows that are looked at."""
OUTSIDE = 0.1
"""Share of a joint's range by which a position may leave it [1]."""
SAME = 0.9
"""Correlation, median over the joints, from which two blocks of one size hold the same quantity [1]."""
HELD = 0.3
"""Share of rows by which a reference stands still more often than the position [1]."""
NOISIER = 2.0
"""Factor between fourth differences of a position and its reference from which they tell which is which [1]."""
WARM = (10.0, 120.0)
"""Range of temperatures of all joints [degC]."""


_Window = tuple[int, ...]
"""Places of columns that may be a block, from 0."""


@dataclass(frozen=True)
class _Block:
    """Columns of one quantity: what they hold, in words of ``meaning_of``, their places from 0, and what tells."""

    holds: str
    places: _Window
    why: str

    def group(self, columns: Sequence[tuple[str, np.ndarray]]) -> ColumnGroup:
        """The columns under a pattern that says what they hold."""
        names = tuple(columns[place][0] for place in self.places)
        said = ", ".join(names)
        # in the order of the file
        if len(names) > 2 and self.places[-1] - self.places[0] == len(names) - 1:
            said = f"{names[0]} to {names[-1]}"
        counted = f"column{'s' if len(names) > 1 else ''} {said}"
        labels = tuple(str(j + 1) for j in range(len(names)))
        values = np.column_stack([columns[place][1] for place in self.places])
        pattern = ", ".join(filter(None, (self.holds, counted)))
        return ColumnGroup(pattern, labels, names, values, self.why, self.holds)


def columns_by_values(
    table: Table, arm: NominalArm | None, context: str
) -> TableColumns:
    """Columns of a table whose names tell no positions: those that names do tell, all others by their values.

    A name without a number counts here, too: the only joint of an arm has none.

    Args:
        table: as a reader gave it.
        arm: the nominal arm, if it is known.
        context: name of the file and the topic, which say what a block that is alone holds.
    """
    every, others = sorted_columns(table, () if arm is None else arm.joints)
    # names that do tell go before values
    groups = [group for group in every if meaning_of(group.pattern).quantity]
    taken = {name for group in groups for name in group.names}
    singles = {}
    for name, x in others.items():
        quantity = meaning_of(name).quantity
        if quantity == "time":
            singles[name] = x
        # an arm of one joint has no number in its names
        elif quantity and (arm is None or arm.n_joints == 1):
            groups.append(ColumnGroup(name, ("1",), (name,), x[:, None], BY_NAME))
            taken.add(name)
    # of columns without a word, those of which a measured velocity is the derivative
    rows = np.asarray(table.row_numbers)
    for group, velocity in product(every, groups):
        meaning, other = meaning_of(group.pattern), meaning_of(velocity.pattern)
        wordless = not meaning.quantity and not meaning.words & NOT_OF_JOINTS
        measured = other.quantity == "velocity" and not other.reference
        alike = wordless and measured and group.width == velocity.width
        if alike and derivative_ratio(rows, group.values, velocity.values) is not None:
            why = f"{velocity.pattern} is its derivative"
            groups.append(replace(group, holds="position", seen=why))
            taken |= set(group.names)
            break
    # positions by name: values need not be asked
    if any(group.meaning("").quantity == "position" for group in groups):
        rest = {name: x for name, x in others.items() if name not in taken}
        return tuple(groups), singles | rest
    silent = {
        name: x
        for name, x in _numbers(table).items()
        if x.ndim == 1
        and name not in taken | set(singles)
        and not words_of(name) & NOT_OF_JOINTS
    }
    singles |= _times(silent)
    columns = [(name, x) for name, x in silent.items() if name not in singles]
    if not columns:
        return tuple(groups), singles
    values = np.column_stack([x[:ROWS] for _, x in columns])
    sound = (np.abs(values) < BEYOND).all(axis=1)
    rows = np.asarray(table.row_numbers[:ROWS])
    if silent.keys() & singles.keys():
        # the time tells where rows are missing in the file itself
        first = next(x for name, x in singles.items() if name in silent)
        step = np.diff(first[:ROWS])
        # a step of two where rows are missing: no difference is taken over it
        rows = np.cumsum(np.r_[0, np.where(step > LOST * np.median(step), 2, 1)])
    values, rows = values[sound], rows[sound]
    # too few rows for a comparison over SPAN
    few = len(values) <= 2 * SPAN
    for block in () if few else _Blocks(values, rows, arm).told(context):
        groups.append(block.group(columns))
        taken |= set(groups[-1].names)
    singles |= {name: x for name, x in columns if name not in taken}
    return tuple(groups), singles


def _times(numbers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns that rise in even steps, the one to read the time from first, and what rises in proportion to it."""
    even = {}
    for name, x in numbers.items():
        if np.isfinite(x).all() and runs_forward(x):
            step = np.diff(x)
            usual = float(np.median(step))
            # sums of steps: rows that were lost make a few large ones
            uneven = float(np.minimum(np.abs(step - usual), usual).mean())
            if uneven < UNEVEN * usual:
                even[name] = uneven / usual
    if not even:
        return {}
    first = numbers[min(even, key=lambda name: even[name])]
    alike = [x for x in even if np.corrcoef(numbers[x], first)[0, 1] > PROPORTIONAL]
    # the number of a row says less than a stamp
    alike.sort(key=lambda name: counts_rows(numbers[name]))
    return {name: numbers[name] for name in alike}


class _Blocks:
    """Finds the blocks in columns of numbers, (N, m)."""

    def __init__(
        self, values: np.ndarray, rows: np.ndarray, arm: NominalArm | None
    ) -> None:
        self.values, self.arm = values, arm
        self.count = values.shape[1]
        self.still = np.ptp(values, axis=0) == 0
        # no rows are lost between
        self.next = np.diff(rows) == 1
        # gain of each column over SPAN rows, against the sum of every other
        whole = rows[SPAN:] - rows[:-SPAN] == SPAN
        gain = (values[SPAN:] - values[:-SPAN])[whole]
        middle = 0.5 * (values[1:] + values[:-1])
        total = np.vstack([np.zeros(self.count), np.cumsum(middle, axis=0)])
        total = (total[SPAN:] - total[:-SPAN])[whole]
        power = (total**2).sum(axis=0)
        product = gain.T @ total
        size = np.sqrt(np.outer((gain**2).sum(axis=0), power))
        with np.errstate(divide="ignore", invalid="ignore"):
            self.cosine = np.where(size > 0, product / size, 0.0)
            self.ratio = np.where(power > 0, product / power, 0.0)
        np.fill_diagonal(self.cosine, 0.0)

    def told(self, context: str) -> list[_Block]:
        """The blocks with what they hold; none if nothing tells how many joints there are."""
        n, order = self._arrangement()
        if not n:
            return []
        if n == self.count:
            # A log of one quantity: by the name of its file, else positions
            if meaning_of("", context).quantity:
                return [_Block("", order, "")]
            return [_Block("position", order, "the only columns, one for each joint")]
        windows = self._windows(n, order)
        pairs = self._pairs(windows)
        found = self._by_derivatives(pairs) if pairs else self._by_smoothness(windows)
        return [*found, *self._rest(windows, order, found)] if found else []

    def _arrangement(self) -> tuple[int, _Window]:
        """Number of joints, and the columns in an order in which those of a quantity follow each other.

        That in which one block is most the derivative of another; without any, in which a block is smoothest.
        """
        known = 0 if self.arm is None else self.arm.n_joints
        blocks, most = tuple(range(self.count)), self.count // 2
        every = [(n, blocks) for n in range(1, most + 1)]
        # one joint after the other
        every += [(self.count // k, self._turned(k)) for k in range(2, most + 1)]

        def rank(arrangement: tuple[int, _Window]) -> tuple[float, bool, int]:
            n, order = arrangement
            sure = 0.0
            for (own, *_), one, other in self._scored(self._windows(n, order)):
                # what stands between a column and its derivative are whole blocks
                if n == known or order != blocks or (other[0] - one[0]) % n == 0:
                    sure = max(sure, -own)
            # a torque may follow the speed of its joint: one column alone speaks for no other arm than the robot
            if 0 < known <= self.count and n != known and sure <= 1:
                sure = 0.0
            # of as many derivatives those of the robot's joints, else the widest block
            return sure, n == known, n

        best = max(every, key=rank, default=(0, blocks))
        if every and rank(best)[0] > 0:
            return best
        n = known or self._smooth_run()
        if not 0 < n <= self.count:
            return 0, blocks
        rough, orders = self._roughness(), [blocks]
        if self.count % n == 0 and self.count > n:
            orders.append(self._turned(self.count // n))

        def roughest(order: _Window) -> float:
            return min(rough[list(w)].max() for w in self._windows(n, order))

        return n, min(orders, key=roughest)

    def _turned(self, stride: int) -> _Window:
        """The columns joint by joint put block by block, for so many blocks; a rest of columns is left out."""
        whole = range(self.count // stride * stride)
        return tuple(sorted(whole, key=lambda place: place % stride))

    def _smooth_run(self) -> int:
        """Joints of a log without velocities: up to the references, or as many as there are smooth columns in a row."""
        # as many columns as look like the first: references of the same joints
        for n in range(1, self.count // 2 + 1):
            if self._like(tuple(range(n)), tuple(range(n, 2 * n))):
                return n
        rough = np.log(np.maximum(self._roughness(), 1e-12))
        ranked = np.sort(rough)
        if self.count < 2:
            return self.count
        # the widest leap of roughness parts positions from all that is noisier
        leap = int(np.argmax(np.diff(ranked)))
        smooth = np.flatnonzero(rough <= ranked[leap])
        together = smooth[-1] - smooth[0] + 1 == len(smooth)
        return len(smooth) if together and self.count % len(smooth) == 0 else 0

    def _roughness(self) -> np.ndarray:
        """Second over first differences of each column [1], (m,); that of a column that stands still is 0."""
        first = np.diff(self.values, axis=0)[self.next].std(axis=0)
        both = self.next[1:] & self.next[:-1]
        second = np.diff(self.values, n=2, axis=0)[both].std(axis=0)
        return np.where(first > 0, second / np.maximum(first, 1e-300), 0.0)

    def _windows(self, n: int, order: _Window) -> list[_Window]:
        """Every n columns that may be a block."""
        # joint after joint blocks stand n apart, else a block may begin anywhere
        step = 1 if order == tuple(range(self.count)) else n
        return [order[s : s + n] for s in range(0, len(order) - n + 1, step)]

    def _scored(
        self, windows: Sequence[_Window]
    ) -> list[tuple[tuple[float, ...], _Window, _Window]]:
        """Blocks and those that are their derivatives, the surest first.

        With each the columns that do not follow less those that do by one factor, and how badly they follow.
        """
        scored, every = [], np.array(windows)
        # of each block against each other, joint by joint
        following = (self.cosine > FOLLOWS)[every[:, None], every]
        for k, m in np.argwhere(following.any(axis=2)):
            one, other, follows = windows[k], windows[m], following[k, m]
            if set(one) & set(other):
                continue
            ratio = self.ratio[one, other][follows]
            alike = int((np.abs(ratio / np.median(ratio) - 1) < ALIKE).sum())
            moving = ~self.still[list(one)]
            # a friction that is viscous follows the velocity, by another factor on each joint
            if 2 * alike >= moving.sum():
                strange = int((moving & ~follows).sum())
                cosine = float(np.median(self.cosine[one, other][follows]))
                scored.append(((strange - alike, -alike, -cosine), one, other))
        return sorted(scored)

    def _pairs(self, windows: Sequence[_Window]) -> list[tuple[_Window, _Window]]:
        """Blocks and those that are their derivatives, the surest first; no two overlap."""
        taken: list[_Window] = []
        pairs = []
        for _, one, other in self._scored(windows):
            news = [window for window in (one, other) if window not in taken]
            # blocks share no column, unless they are the same
            if any(set(window) & set(old) for window in news for old in taken):
                continue
            taken += news
            pairs.append((one, other))
        return pairs

    def _by_derivatives(self, pairs: Sequence[tuple[_Window, _Window]]) -> list[_Block]:
        """Positions, velocities and accelerations of measured motion and of references."""
        # a derivative of another block is no position
        positions = {one for one, _ in pairs} - {other for _, other in pairs}
        if not positions:
            return []
        measured, references = self._measured(sorted(positions))
        why = "its derivative is in the log"
        if self._within_limits(measured):
            why += ", and stays within the limits of the robot"
        found = [_Block("position", measured, why), *references]
        own = [other for one, other in pairs if one == measured]
        velocity, _ = self._measured(sorted(own))
        for other in own:
            holds = "velocity" if other == velocity else "reference velocity"
            found.append(_Block(holds, other, "follows the derivative of the position"))
        for one, other in pairs:
            if one in positions and other not in own:
                why = "follows the derivative of the reference"
                found.append(_Block("reference velocity", other, why))
                own.append(other)
        # what follows a velocity is an acceleration, known blocks first
        known = {block.places for block in found}
        for one, other in pairs:
            if one in known and one not in positions and other not in known:
                why = "follows the derivative of the velocity"
                found.append(_Block("acceleration", other, why))
                known.add(other)
        return found

    def _measured(self, windows: Sequence[_Window]) -> tuple[_Window, list[_Block]]:
        """Of blocks of one quantity the one that was measured, and the others as references."""
        measured, *others = windows
        references = []
        for other in others:
            turned, why = self._reference_first(measured, other)
            reference, measured = (measured, other) if turned else (other, measured)
            references.append(_Block("reference position", reference, why))
        return measured, references

    def _like(self, one: _Window, other: _Window) -> bool:
        """Whether two blocks hold the same quantity: joint by joint of one course and size."""
        x, y = self.values[:, list(one)], self.values[:, list(other)]
        moving = (np.ptp(x, axis=0) > 0) & (np.ptp(y, axis=0) > 0)
        if not moving.any():
            return False
        x, y = x[:, moving], y[:, moving]
        size = y.std(axis=0) / x.std(axis=0)
        x, y = x - x.mean(axis=0), y - y.mean(axis=0)
        cosine = (x * y).mean(axis=0) / (x.std(axis=0) * y.std(axis=0))
        # of the same size within a factor of two: a scaled copy is something else
        return bool(np.median(cosine) > SAME and np.abs(np.log(size)).max() < np.log(2))

    def _reference_first(self, one: _Window, other: _Window) -> tuple[bool, str]:
        """Whether the first of two blocks of one quantity is the reference of the other; and what tells."""
        steps = [
            np.diff(self.values[:, list(window)], axis=0) for window in (one, other)
        ]
        # set points are held over several rows, encoders hardly ever
        held = [float((step == 0).mean()) for step in steps]
        if abs(held[0] - held[1]) > HELD:
            why = "like what was measured, and held between set points"
            return held[0] > held[1], why
        # what is computed is smoother than what encoders measure; the median passes over lost rows
        noise = [float(np.median(np.abs(np.diff(step, n=3, axis=0)))) for step in steps]
        if max(noise) > NOISIER * min(noise):
            return noise[0] < noise[1], "like what was measured, and smoother"
        # by how many rows a block comes after another of the same quantity; 0 if it does not follow it
        a, b = (self.values[:, list(window)] for window in (one, other))
        slope = np.gradient(a, axis=0)
        slope = slope - slope.mean(axis=0)
        power = (slope**2).sum(axis=0)
        # late by d rows: the error is -d times the slope
        lags = (slope * (a - b)).sum(axis=0)[power > 0] / power[power > 0]
        ahead = bool(len(lags)) and float(np.median(lags)) > 0
        return ahead, "like what was measured, and ahead of it"

    def _within_limits(self, window: _Window) -> bool:
        """Whether columns stay within the limits of the robot in one of the units of positions."""
        if self.arm is None or len(window) != self.arm.n_joints:
            return False
        lower, upper = RigidBody(self.arm).position_limits()
        # limits that are infinite need no margin
        wide = OUTSIDE * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        x = self.values[:, list(window)]
        low, high = x.min(axis=0), x.max(axis=0)
        # in any unit of positions: which one is asked later
        return any(
            bool(((low * f >= lower - wide) & (high * f <= upper + wide)).all())
            for f in (UNITS[unit] for unit in ANGLES)
        )

    def _by_smoothness(self, windows: Sequence[_Window]) -> list[_Block]:
        """The positions of a log that holds no velocity: the smoothest columns within the robot's limits."""
        rough = self._roughness()
        moving = [w for w in windows if not self.still[list(w)].all()]
        inside = [w for w in moving if self._within_limits(w)]
        possible = inside or moving
        if not possible:
            return []
        # the roughest joint of a block decides: all of them are positions
        best = min(possible, key=lambda w: float(rough[list(w)].max()))
        why = "the smoothest columns"
        if inside:
            why += " that stay within the limits of the robot"
        alike = [best]
        # windows of which none overlaps one before it
        for window in moving:
            apart = not set(window) & {place for other in alike for place in other}
            if apart and self._like(best, window):
                alike.append(window)
        measured, references = self._measured(sorted(alike))
        why += "; no column is their derivative"
        return [_Block("position", measured, why), *references]

    def _rest(
        self, every: Sequence[_Window], order: _Window, found: Sequence[_Block]
    ) -> list[_Block]:
        """Blocks beside those that are known: references, temperatures, and possible torques, the likeliest first."""
        starts = [order.index(block.places[0]) for block in found]

        def away(window: _Window) -> int:
            return min(abs(order.index(window[0]) - start) for start in starts)

        # blocks fill what lies beside those that are known, from these on
        taken = {place for block in found for place in block.places}
        windows = []
        for window in sorted(every, key=away):
            if not taken & set(window):
                windows.append(window)
                taken |= set(window)
        position = found[0].places
        # what has two values is a switch
        several = np.array([len(np.unique(x)) > 2 for x in self.values.T])
        moving = [w for w in windows if several[list(w)].any()]
        # a torque moves the arm or follows from its motion
        moving.sort(key=lambda window: -self._explained(position, window))
        return [self._other(window, position) for window in moving]

    def _explained(self, position: _Window, window: _Window) -> float:
        """Share of the variance of a block that the motion of each column's own joint explains [1]."""
        shares = []
        for p, w in zip(position, window, strict=True):
            q, y = self.values[:, p], self.values[SPAN:-SPAN, w]
            speed = (q[2 * SPAN :] - q[: -2 * SPAN]) / 2
            bend = q[2 * SPAN :] - 2 * q[SPAN:-SPAN] + q[: -2 * SPAN]
            # a constant, place, speed, its sign, and acceleration of the joint
            own = (np.ones_like(y), q[SPAN:-SPAN], speed, np.sign(speed), bend)
            columns = np.column_stack(own)
            left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
            shares.append(1 - left.var() / max(y.var(), 1e-300))
        return float(np.mean(shares))

    def _other(self, window: _Window, position: _Window) -> _Block:
        """A block that no derivative tells."""
        x = self.values[:, list(window)]
        if self._like(position, window):
            return _Block("reference position", window, "like what was measured")
        if x.min() > WARM[0] and x.max() < WARM[1]:
            why = f"{x.min():.3g} to {x.max():.3g} on all joints"
            return _Block("temperature", window, why)
        why = "what is left beside the motion"
        why += "; with --robot gravity tells more" if self.arm is None else ""
        return _Block("torque", window, why)
