"""The next recording that a diagnosis suggests, from its own findings; ``gapscope advise`` designs it in detail."""

from __future__ import annotations

from typing import Any

from gapscope.diagnosis.document.wording import effect_name
from gapscope.diagnosis.thresholds import OPEN_ALTERNATIVE


def suggested_recording(
    effects: list[dict[str, Any]],
    possible: list[dict[str, Any]],
    open_joints: list[int],
) -> str | None:
    """What to record to settle what is still open, or ``None``.

    Args:
        effects: findings that are named, the one with the largest share first.
        possible: findings that are possible only, likewise.
        open_joints: joints whose residual is above the floor, from 1.
    """
    for effect in (*effects, *possible):
        for alternative in effect["alternatives"]:
            # no recording tells two names of one cause apart
            separable = not alternative.get("equivalent")
            if separable and alternative["probability"] >= OPEN_ALTERNATIVE:
                return _to_tell_apart(effect["effect"], alternative)
    if not open_joints:
        return None
    joints = ", ".join(map(str, open_joints))
    return (
        f"to place what is unexplained on joint {joints}: "
        "that joint alone, the same path at half and double speed"
    )


def _to_tell_apart(effect: str, alternative: dict[str, Any]) -> str:
    other = effect_name(alternative["effect"]).replace("none", "nothing")
    return f"to tell {effect_name(effect)} from {other}: {alternative['separated_by']}"
