"""Which recordings are fitted, and which are held out."""

from __future__ import annotations

from collections.abc import Sequence

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording

HELD_OUT = 1 / 3
"""Share of a single recording that is held out, its end [1]."""


def split(
    case: Case, chosen: Sequence[str] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and held-out ones: those chosen by name, else the case's, else the last one or the last third.

    Raises:
        InputError: a name is not that of a recording, or none remains to fit.
    """
    everything = [*case.recordings, *case.judged]
    if chosen:
        names = [recording.name for recording in everything]
        for name in chosen:
            if name not in names:
                raise InputError(
                    f"no recording is called {name!r}",
                    f"there are {', '.join(names)}",
                    where="--judge",
                )
        fit = [r for r in everything if r.name not in chosen]
        if not fit:
            raise InputError(
                "every recording is held out, none remains to fit",
                where="--judge",
            )
        return fit, [r for r in everything if r.name in chosen]
    if case.judged:
        return list(case.recordings), list(case.judged)
    if len(case.recordings) > 1:
        return list(case.recordings[:-1]), [case.recordings[-1]]
    (only,) = case.recordings
    cut = int(len(only.t) * (1 - HELD_OUT))
    start = only.part(slice(0, cut), name=f"{only.name}, start")
    end = only.part(slice(cut, None), name=f"{only.name}, end")
    return [start], [end]
