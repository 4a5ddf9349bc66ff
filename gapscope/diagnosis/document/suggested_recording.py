"""The next recording that a diagnosis suggests, from its own findings; ``gapscope advise`` designs it in detail."""

from __future__ import annotations

from typing import Any

from gapscope.arm.display import effect_name
from gapscope.diagnosis.document.wording import coupling_text
from gapscope.diagnosis.selection.undeclared_coupling import UndeclaredCoupling
from gapscope.diagnosis.thresholds import OPEN_ALTERNATIVE


def suggested_recording(
    effects: list[dict[str, Any]],
    possible: list[dict[str, Any]],
    open_joints: list[int],
    coupling: UndeclaredCoupling | None = None,
) -> str | None:
    """What to record, or to declare first, to settle what is still open, or ``None``.

    Args:
        effects: findings that are named, the one with the largest share first.
        possible: findings that are possible only, likewise.
        open_joints: joints whose residual the verdict calls unexplained, from 1.
        coupling: two joints that seem to be turned by one motor.
    """
    if coupling is not None:
        return (
            f"none yet: first look whether one motor turns joints {coupling.joint} and {coupling.motor}, declare it in "
            f"the case as {coupling_text(coupling.declaration)}, and diagnose again"
        )
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
