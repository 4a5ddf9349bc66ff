"""Dates in the names of folders and cases."""

from __future__ import annotations

import re
from datetime import datetime

_DATE = re.compile(
    r"""(?<!\d)
    (?P<year>20\d\d)
    (?:(?P<mark>[-_.])(?P<month>\d\d)(?:(?P=mark)(?P<day>\d\d))?   # 2026-03, 2026_03_14
      |(?P<packed>\d{4}))                                          # 20260314
    (?:[T_ -](?P<hour>\d\d)[-_:.]?(?P<minute>\d\d)(?:[-_:.]?(?P<second>\d\d))?)?
    (?!\d)""",
    re.VERBOSE,
)
_MARKS = "-_. "
"""Between a date and the rest of a name."""


def split_date(name: str) -> tuple[datetime | None, str]:
    """The date in a name, and the name without it.

    Args:
        name: of a folder or a case, e.g. ``arm7_2026-03-14``, ``20260314_0930`` or ``2026-03`` (its first day).

    Returns:
        The first date, local time, ``None`` if there is none; the rest of the name, which may be empty.
    """
    for match in _DATE.finditer(name):
        date = _date(match)
        if date is not None:
            parts = (name[: match.start()], name[match.end() :])
            rest = [part.strip(_MARKS) for part in parts]
            return date, "_".join(part for part in rest if part)
    return None, name


def _date(match: re.Match[str]) -> datetime | None:
    """The date of a match; ``None`` if the calendar does not have it."""
    packed = match["packed"] or ""
    month, day = match["month"] or packed[:2], match["day"] or packed[2:] or "1"
    clock = [match[part] or "0" for part in ("hour", "minute", "second")]
    text = f"{match['year']}-{month}-{int(day):02d} {':'.join(clock)}"
    try:
        return datetime.strptime(text, "%Y-%m-%d %H:%M:%S")
    except ValueError:
        return None
