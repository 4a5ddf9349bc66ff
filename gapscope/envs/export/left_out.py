"""What a format cannot hold of a corrected arm, a sentence each."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.odd_inertials import odd_inertials
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import usual_load
from gapscope.envs.export.plain_arm import PlainArm

FORMATS = ("urdf", "mjcf", "sdf")
"""Formats that can be written."""
EVERYWHERE = {
    "payload",
    "link_inertia",
    "base_tilt",
    "coulomb_friction",
    "viscous_friction",
    "torque_saturation",
    "encoder_offset",
}
"""Effects that every format holds."""
HELD = {
    "urdf": EVERYWHERE,
    "sdf": EVERYWHERE | {"parallel_spring"},
    "mjcf": EVERYWHERE
    | {"parallel_spring", "armature", "stribeck_friction", "saturating_friction"}
    | {"torque_scale", "torque_offset", "torque_ripple"}
    | {"actuator_lag", "actuator_delay", "joint_elasticity", "backlash"}
    | {"coupled_coulomb_friction", "coupled_viscous_friction", "coupled_armature"},
}
"""Effects that a format holds."""
TWO_MASSES = ("joint_elasticity", "backlash")
"""Effects that need a motor of its own, with a rotor."""
HINTS = {
    "friction_drift": "friction of the file is that without drift; at the start of a recording it is 1 + amplitude "
    "times as large",
    "external_force": "it belongs to the recording in which it acted",
    "encoder_quantization": "round what is read to it",
    "actuator_delay": "hold the command back by it",
    "stribeck_friction": "friction of the file at rest is lower by it",
    "saturating_friction": "friction of the file in motion is lower by it",
}
"""What to do about effects that are left out."""


def left_out(arm: PlainArm, form: str) -> tuple[str, ...]:
    """What a file of this format leaves out of a corrected arm, in words and figures."""
    corrected = arm.corrected
    lines = [
        described(e, corrected.arm)
        for e in corrected.effects
        if e.name not in HELD[form] and e.name != "armature"
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
    if form == "mjcf" and any(drive.velocity for drive in arm.drives.values()):
        lines.append("velocity limits of the joints: MuJoCo knows none")
    kept = form == "urdf"  # whose elements stay as they are
    return (
        *lines,
        *(
            f"{x}, its name is kept" if kept and x.endswith("is not found") else x
            for x in arm.missing
        ),
    )


def _without_rotor(arm: PlainArm) -> list[str]:
    """Effects of a gear on joints whose rotor is not known."""
    lines = []
    names = arm.corrected.arm.joints
    for effect in arm.corrected.effects:
        if effect.name not in TWO_MASSES:
            continue
        rigid = [j for j in effect.joints if arm.drives[names[j - 1]].gear is None]
        if rigid:
            lines.append(
                f"{effect.name}, joint{'s' * (len(rigid) > 1)} {_figures(np.array(rigid))}: a motor of its own needs "
                "a rotor; give nominal.armature in the data sheet, or add the effect armature"
            )
    return lines


def _beside_the_format(arm: PlainArm) -> list[str]:
    """What the joints of the data sheet have and the format does not."""
    joints = [arm.drives[joint] for joint in arm.corrected.arm.joints]
    rotors = np.array([drive.armature for drive in joints])
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
    definition = applied.effect
    joints = (
        f", joint{'s' * (len(applied.joints) > 1)} {', '.join(map(str, applied.joints))}"
        if applied.joints
        else ""
    )
    values = "; ".join(
        f"{p.name} {_figures(applied.parameters[p.name])}"
        + ("" if p.unit == "1" else f" {p.unit}")
        for p in definition.parameters
    )
    hint = hint or _hint(applied, arm)
    return f"{applied.name}{joints}: {values}" + (f" ({hint})" if hint else "")


def _hint(applied: AppliedEffect, arm: NominalArm) -> str | None:
    """What to do about an effect that is left out, if there is anything to say."""
    if applied.name != "load_friction":
        return HINTS.get(applied.name)
    nearest = _figures(nearest_coulomb(applied, arm))
    return (
        f"nearest: Coulomb friction higher by {nearest} N m, the coefficient times the RMS of the load over all "
        "postures; better, times the load of your motion"
    )


def nearest_coulomb(load: AppliedEffect, arm: NominalArm) -> np.ndarray:
    """Coulomb friction that takes as much as load friction from a motor that carries the usual load [N m], per joint.

    That is the RMS of gravity and dry friction over all postures.
    """
    rows = np.array(load.joints, dtype=int) - 1
    usual = usual_load(arm)[rows]
    return np.asarray(load.parameters["coefficient"] * usual)


def _figures(values: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in np.atleast_1d(values).tolist())
