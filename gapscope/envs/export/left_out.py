"""What a format cannot hold of a corrected arm, a sentence each."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from gapscope.arm.dynamics.odd_inertials import odd_inertials
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import usual_load
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect
from gapscope.envs.export.plain_arm import PlainArm

FORMATS = ("urdf", "mjcf", "sdf")
"""Formats that can be written."""
EVERYWHERE = {"body", "load", "gravity", "friction", "damping", "limit", "zero"}
"""Quantities that every format holds."""
GEAR = {"gear_stiffness", "gear_damping", "play"}
"""Quantities between a joint and a motor of its own, which needs a rotor."""
HELD = {
    "urdf": EVERYWHERE,
    "sdf": EVERYWHERE | {"stiffness", "rest"},
    "mjcf": EVERYWHERE
    | {"stiffness", "rest", "rotor", "delay", "lag", "scale", "offset"}
    | {"breakaway", "breakaway_speed", "saturating", "saturating_speed"}
    | {"ripple", "ripple_cycles", "ripple_phase"}
    | {"motor_friction", "motor_damping", "motor_rotor"}
    | GEAR,
}
"""Quantities that a format holds."""


NOT_FOUND = "is not found"
"""How it ends what is said of a mesh that is not there."""


def holds(held: Collection[str], effect: Effect) -> bool:
    """Whether what has these quantities has the whole effect, all of whose parameters are some of them."""
    return all(effect.quantities.get(name) in held for name in effect.names)


def left_out(arm: PlainArm, form: str) -> tuple[str, ...]:
    """What a file of this format leaves out of a corrected arm, in words and figures."""
    corrected = arm.corrected
    # rotors are told in total, nominal and found
    held = HELD[form] | {"rotor"}
    lines = [
        described(e, corrected.arm)
        for e in corrected.effects
        if not holds(held, e.effect)
    ]
    if form == "mjcf":
        lines += _without_rotor(arm)
    else:
        lines += _beside_the_format(arm)
    if corrected.residual is not None:
        lines.append("residual network: it predicts torque and moves nothing")
    if corrected.arm.encoder_step:
        lines.append(
            f"resolution of the encoders: {corrected.arm.encoder_step:.4g} rad"
        )
    if form == "mjcf" and any(d.velocity < np.inf for d in arm.drives.values()):
        lines.append("velocity limits of the joints: MuJoCo knows none")
    # of a URDF the elements stay as they are, if their mesh is in a package that may be elsewhere
    kept = [
        form == "urdf" and x.endswith(NOT_FOUND) and "://" in x for x in arm.missing
    ]
    ends = (", its name is kept" if name_kept else "" for name_kept in kept)
    return (*lines, *(x + end for x, end in zip(arm.missing, ends, strict=True)))


def _without_rotor(arm: PlainArm) -> list[str]:
    """Effects of a gear on joints whose rotor is not known."""
    lines = []
    names = arm.corrected.arm.joints
    for applied in arm.corrected.effects:
        if GEAR.isdisjoint(applied.effect.quantities.values()):
            continue
        rigid = [j for j in applied.joints if arm.drives[names[j - 1]].gear is None]
        if rigid:
            lines.append(
                f"{applied.name}{_joints(rigid)}: a motor of its own needs a rotor; give nominal.armature in the data "
                "sheet, or add the effect armature"
            )
    return lines


def _beside_the_format(arm: PlainArm) -> list[str]:
    """What the joints of the data sheet have and the format does not."""
    joints = [arm.drives[joint] for joint in arm.corrected.arm.joints]
    rotors = np.array([drive.rotor for drive in joints])
    distances = np.array([drive.presliding for drive in joints])
    lines = []
    if rotors.any():
        lines.append(
            f"armature (nominal and found), joints in order: inertia {_figures(rotors)} kg m^2"
        )
    if distances.any():
        lines.append(
            f"presliding, joints in order: distance {_figures(distances)} rad (friction of the file sets in at once)"
        )
    return lines


def remarks(arm: PlainArm) -> tuple[str, ...]:
    """Implausible bodies, a sentence each, with the file's name instead of its path."""
    return tuple(
        note.replace(str(arm.body.file), arm.body.file.name)
        for note in odd_inertials(arm.body)
    )


def described(applied: AppliedEffect, arm: NominalArm, hint: str | None = None) -> str:
    """An effect on an arm with its joints and values, and what to do about it where it is left out.

    Args:
        applied: the effect.
        arm: the nominal arm.
        hint: what to do, in place of what holds for every format.
    """
    values = "; ".join(
        f"{p.name} {_figures(applied.parameters[p.name])}"
        + ("" if p.unit == "1" else f" {p.unit}")
        for p in applied.effect.parameters
    )
    hint = hint or _hint(applied, arm)
    return f"{applied.name}{_joints(applied.joints)}: {values}" + (
        f" ({hint})" if hint else ""
    )


def _hint(applied: AppliedEffect, arm: NominalArm) -> str:
    """What to do about an effect that is left out; empty if there is nothing to say."""
    nearest = nearest_friction(CorrectedArm(arm, (applied,)))
    if not nearest.any():
        return applied.effect.without
    figures = _figures(nearest[np.array(applied.joints) - 1])
    return (
        f"nearest: Coulomb friction higher by {figures} N m, the coefficient times the RMS of the load over all "
        "postures; better, times the load of your motion"
    )


def nearest_friction(corrected: CorrectedArm) -> np.ndarray:
    """Coulomb friction that takes as much as friction by load does from motors that carry the usual load [N m], (n,).

    That is the RMS of gravity and dry friction over all postures.
    """
    factor = corrected.quantity("load_factor")
    return factor * usual_load(corrected.arm) if factor.any() else factor


def _joints(numbers: Collection[int]) -> str:
    """Joints of an effect, as they follow its name; empty without any."""
    if not numbers:
        return ""
    return f", joint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _figures(values: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in np.atleast_1d(values).tolist())
