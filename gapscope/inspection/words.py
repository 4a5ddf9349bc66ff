"""Units and words of an inspection."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from gapscope.arm.io.channel_entry import STEPS_PER_TURN
from gapscope.arm.io.import_section import UNITS

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
