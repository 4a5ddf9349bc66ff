"""Motors that turn several joints, in MJCF: tendons whose length is D_m q, with rotor and friction of their own."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from gapscope.effects.coupled_motors import (
    COUPLED_ARMATURE,
    COUPLED_COULOMB,
    COUPLED_VISCOUS,
)
from gapscope.effects.passivity import total
from gapscope.envs.export.plain_arm import PlainArm

ATTRIBUTES = (
    ("armature", COUPLED_ARMATURE.name, "inertia", "kg m^2"),
    ("damping", COUPLED_VISCOUS.name, "coefficient", "N m s/rad"),
    ("frictionloss", COUPLED_COULOMB.name, "torque", "N m"),
)
"""Attributes of a tendon, and the effects and parameters that they hold."""


def add_coupled_motors(tendons: ET.Element, arm: PlainArm) -> None:
    """A tendon for each motor that has something of its own, whose torque acts on its joints along D_m^T.

    Raises:
        InputError: friction or rotor inertia is negative.
    """
    coupling = arm.corrected.arm.coupling
    if coupling is None:
        return
    values = {
        attribute: total(arm.corrected.value(name, parameter), name, unit)
        for attribute, name, parameter, unit in ATTRIBUTES
    }
    present = np.any(list(values.values()), axis=0)
    for motor in np.flatnonzero(present).tolist():
        tendon = ET.SubElement(tendons, "fixed", name=f"motor_{motor + 1}")
        for attribute, each in values.items():
            if each[motor]:
                tendon.set(attribute, repr(float(each[motor])))
        for joint, ratio in zip(arm.corrected.arm.joints, coupling[motor], strict=True):
            if ratio:
                ET.SubElement(tendon, "joint", joint=joint, coef=repr(float(ratio)))
