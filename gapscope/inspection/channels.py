"""Which columns of a log are which channel of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.io.layouts import Layout
from gapscope.inspection.columns import BY_NAME, ColumnGroup, TableColumns
from gapscope.inspection.time_column import TimeGuess
from gapscope.inspection.words import (
    Meaning,
    derivative_ratio,
    position_unit,
    velocity_unit,
)

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
