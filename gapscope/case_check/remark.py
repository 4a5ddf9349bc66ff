"""One line of the check of a case."""

from __future__ import annotations

from dataclasses import dataclass

LEVELS = ("ok", "warn", "error")
"""As it should be; can be diagnosed, with what it costs; cannot be diagnosed."""


@dataclass(frozen=True)
class Remark:
    """One line of the check of a case.

    Attributes:
        level: one of ``LEVELS``.
        topic: ``case``, ``recordings``, ``channels``, ``time``, ``positions``, ``torque``, ``excitation``,
            ``data sheet``, ``controller`` or ``model``.
        place: recordings or joints that it concerns, or an empty string.
        said: what was found, with numbers and units.
        remedy: what to do; empty if nothing is to be done.
    """

    level: str
    topic: str
    place: str
    said: str
    remedy: str = ""


def numbers(joints: list[int]) -> str:
    """Joints, counted from 1, in words."""
    listed = ", ".join(str(joint) for joint in joints)
    return f"joint {listed}" if len(joints) == 1 else f"joints {listed}"
