"""The verdict of a diagnosis, from four facts."""

from __future__ import annotations

from typing import Literal

Verdict = Literal["effects_found", "no_gap", "unexplained"]


def verdict(
    *, found: bool, explained: bool, significant: bool, rejected: bool
) -> Verdict:
    """The verdict of a diagnosis.

    Args:
        found: an effect, a fault of the set-up or a change during a recording is named.
        explained: the residual is no more than named effects may leave of a gap.
        significant: the residual is more than noise that is louder than estimated.
        rejected: an effect was found and rejected on held-out data.
    """
    if found:
        return "effects_found" if explained or not significant else "unexplained"
    # A rejected effect explained a gap in the recordings to which it was fitted: the gap exists, its cause is open.
    if significant or rejected:
        return "unexplained"
    return "no_gap"
