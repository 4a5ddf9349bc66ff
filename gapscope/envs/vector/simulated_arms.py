"""The simulated arms of many environments: torque is held over steps of the simulation, as ``SimulatedArm`` does."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Transmission
from gapscope.envs.drive.arm_drive import ArmDrive
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.randomisation import Randomisation

ONE_BY_ONE = (
    "gymnasium.make_vec(..., vectorization_mode='sync') steps such arms one by one"
)
"""What to do if arms cannot be stepped together."""


def check_drawn(randomisation: Randomisation | EffectRanges | None) -> None:
    """Check that no effect may be drawn with which an arm cannot be stepped beside others.

    Raises:
        InputError: one may be; names it.
    """
    if randomisation is None:
        return
    ranges = isinstance(randomisation, EffectRanges)
    names = (
        [item.low.name for item in randomisation.ranges]
        if isinstance(randomisation, EffectRanges)
        else list(randomisation.names)
    )
    for name in names:
        effect = CATALOGUE[name]
        if isinstance(effect, Transmission) or effect.reach == "motor":
            raise InputError(
                f"{name} may be drawn, with which arms are not stepped together",
                ONE_BY_ONE,
                where="ranges" if ranges else "randomisation.names",
            )


def drive_beside_others(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], dt: float, nominal: RigidBody
) -> ArmDrive:
    """The drives and bodies of an arm with effects that is stepped beside others, as ``ArmDrive``.

    Raises:
        InputError: they do not fit the arm, or the arm cannot be stepped beside others.
    """
    drive = ArmDrive(arm, effects, dt, nominal)
    flexible = np.flatnonzero(~drive.rigid)
    why = ""
    if len(flexible):
        why = "an elastic joint or one with play has a motor of its own"
    elif drive.coupled.present:
        why = "a motor turns several joints"
    elif drive.parts > 1:
        why = f"a spring divides each step into {drive.parts} parts"
    if why:
        names = ", ".join(applied.name for applied in effects)
        raise InputError(
            f"{why}, which the vector environment does not step ({names})",
            ONE_BY_ONE,
            where="effects",
        )
    return drive
