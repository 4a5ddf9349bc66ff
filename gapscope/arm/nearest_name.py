"""What to offer when a name is not known."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any

from gapscope.arm.errors import InputError

SHORTEST = 3
"""Letters that a part of a name needs for the name to be offered."""


MOST_NAMES = 40
"""Names that a message lists."""


def shortened(names: Sequence[str]) -> str:
    """Names in a row, at most ``MOST_NAMES`` of them."""
    rest = len(names) - MOST_NAMES
    more = f" and {rest} more" if rest > 0 else ""
    return ", ".join(names[:MOST_NAMES]) + more


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
        f"unknown {kind} {name!r}",
        f"{nearest(str(name), known)}known are {', '.join(known)}",
        where=where,
    )


def check_keys(content: object, known: Iterable[str]) -> dict[str, Any]:
    """The content of a file or a part of one, if it is keys with values, all of them known.

    Raises:
        InputError: it is something else, or there is another key; the nearest is offered.
    """
    known = list(known)
    if not isinstance(content, dict):
        raise InputError("expected names with values", f"known are {', '.join(known)}")
    for key in content:
        check_known("key", key, known, where=str(key))
    return content


def nearest(name: str, known: Iterable[str]) -> str:
    """A question after the nearest of the known names, or nothing if none is near; case does not matter.

    Near is what is written alike, else what has the name as a part, or is a part of it.
    """
    names = {each.casefold(): each for each in known}
    wanted = name.strip().casefold()
    # two letters are a part of too many names
    parts = [
        each
        for each in names
        if min(len(wanted), len(each)) >= SHORTEST
        and (wanted in each or each in wanted)
    ]
    close = get_close_matches(wanted, names, n=1) or parts
    return f"did you mean {names[close[0]]!r}? " if close else ""
