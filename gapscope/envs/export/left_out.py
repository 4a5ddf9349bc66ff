"""What a format cannot hold of a corrected arm, a sentence each."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.odd_inertials import odd_inertials
from gapscope.effects.applied import AppliedEffect
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
}
"""Effects that every format holds."""
HELD = {
    "urdf": EVERYWHERE,
    "sdf": EVERYWHERE | {"parallel_spring"},
    "mjcf": EVERYWHERE
    | {"parallel_spring", "armature", "torque_scale", "torque_offset", "actuator_lag"},
}
"""Effects that a format holds."""
HINTS = {
    "encoder_offset": "joints of the file are at their true positions, what encoders read minus the offset",
    "friction_drift": "friction of the file is that without drift",
    "external_force": "it belongs to the recording in which it acted",
    "stribeck_friction": "friction of the file at rest is lower by it",
    "saturating_friction": "friction of the file in motion is lower by it",
}
"""Remarks on effects that are left out."""


def left_out(arm: PlainArm, form: str) -> tuple[str, ...]:
    """What a file of this format leaves out of a corrected arm, in words and figures."""
    corrected = arm.corrected
    lines = [
        described(e)
        for e in corrected.effects
        if e.name not in HELD[form] and e.name != "armature"
    ]
    rotors = [arm.drives[joint].armature for joint in corrected.arm.joints]
    if form != "mjcf" and any(rotors):
        lines.append(
            f"armature (nominal and found), joints in order: inertia {_figures(np.array(rotors))} kg m^2"
        )
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


def remarks(arm: PlainArm) -> tuple[str, ...]:
    """Implausible bodies, a sentence each, with the file's name instead of its path."""
    return tuple(
        note.replace(str(arm.body.file), arm.body.file.name)
        for note in odd_inertials(arm.body)
    )


def described(applied: AppliedEffect) -> str:
    """An effect with its joints and values."""
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
    hint = HINTS.get(applied.name)
    return f"{applied.name}{joints}: {values}" + (f" ({hint})" if hint else "")


def _figures(values: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in np.atleast_1d(values).tolist())
