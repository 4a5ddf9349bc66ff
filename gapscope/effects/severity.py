"""Realistic severities: every effect drawn at random, in proportion to the arm that it is put on.

What depends on the size of an arm is drawn relative to its torque, inertia and speed; what does not (times, angles,
shares) comes from the ranges met on real arms. Both are those of the catalogue's ``typical`` for arms of 5 to 30 kg.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.effect import Transmission


def possible(arm: NominalArm) -> tuple[str, ...]:
    """Effects that an arm can be given as it is: a motor of its own needs rotor inertia on every joint."""
    motors_known = (arm.armature > 0).all()
    return tuple(
        name
        for name, effect in CATALOGUE.items()
        if motors_known or not isinstance(effect, Transmission)
    )


def draw(
    name: str,
    rng: np.random.Generator,
    scale: ArmScale,
    joints: Sequence[int] | None = None,
) -> AppliedEffect:
    """An effect with values of the size that real arms have.

    Args:
        name: name in the catalogue.
        rng: source of the values.
        scale: of the arm.
        joints: joints from 1 that it acts on; one or two at random if ``None``. Of no meaning for arm and link.

    Raises:
        InputError: unknown effect.
    """
    definition = by_name(name)
    chosen: tuple[int, ...] = ()
    if definition.scope == "joint":
        n = len(scale.torque)
        some = (
            rng.choice(n, size=min(n, int(rng.integers(1, 3))), replace=False) + 1
            if joints is None
            else joints
        )
        chosen = tuple(sorted(int(joint) for joint in some))
    j = np.array(chosen, dtype=int) - 1
    drawn = definition.severity and definition.severity(rng, scale, j)
    clipped = {}
    for p in definition.parameters:
        # a parameter that need not be given is only there if it is drawn
        if p.absent is not None and p.name not in (drawn or {}):
            continue
        if drawn:
            value = drawn[p.name]
        else:
            # evenly from the typical range, for the joints or a vector's components independently
            size = len(j) if definition.scope == "joint" else p.size
            even = rng.uniform(*p.typical, size)
            value = even if definition.scope == "joint" or size > 1 else even[0]
        # a large or small arm may bring a value out of what is possible
        clipped[p.name] = np.clip(value, *p.bounds)
    return AppliedEffect(name, chosen, clipped)
