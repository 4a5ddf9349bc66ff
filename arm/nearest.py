"""What to offer when a name is not known."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from arm.errors import InputError


def check_known(kind: str, name: object, known: Iterable[str], where: str = "") -> str:
    """The name, if it is one of the known ones.

    Args:
        kind: what is named, for the message.
        name: what the user gave.
        known: the names that there are.
        where: the argument or field at fault.

    Raises:
        InputError: it is not; the nearest name is offered.
    """
    known = list(known)
    if isinstance(name, str) and name in known:
        return name
    raise InputError(
        f"unknown {kind} {name!r}", f"{nearest(str(name), known)}known are {', '.join(known)}", where=where
    )


def nearest(name: str, known: Iterable[str]) -> str:
    """A question after the nearest of the known names, or nothing where none is near."""
    close = get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}? " if close else ""
