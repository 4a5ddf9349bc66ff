"""What the name of a column says that it holds."""

from __future__ import annotations

import re
from dataclasses import dataclass

QUANTITIES = {
    "position": {"q", "position", "pos", "angle", "theta", "state", "action"},
    "velocity": {"dq", "qd", "qdot", "velocity", "vel", "speed", "omega"},
    "acceleration": {"ddq", "qdd", "acceleration", "acc"},
    "torque": {"tau", "torque", "effort", "moment", "trq"},
    "current": {"current", "cur", "curr", "amp", "amps", "i", "iq"},
    "temperature": {"temperature", "temp"},
    "time": {"t", "time", "timestamp", "stamp", "sec", "secs", "seconds"},
}
"""Words for a quantity; the first match in this order counts."""
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
    found = _quantity(own) or _quantity(around)
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
