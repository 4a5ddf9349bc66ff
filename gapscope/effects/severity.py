"""Realistic severities: every effect drawn at random, in proportion to the arm that it is put on.

What depends on the size of an arm is drawn relative to its torque, inertia and speed; what does not (times, angles,
shares) comes from the ranges met on real arms. Both are those of the catalogue's ``typical`` for arms of 5 to 30 kg.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.effect import Effect, Transmission
from gapscope.effects.parametrisation import Values


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
    severity = definition.severity or partial(_typical, definition)
    values = severity(rng, scale, j)
    clipped = {
        p.name: np.clip(values[p.name], *p.bounds) for p in definition.parameters
    }
    return AppliedEffect(name, chosen, clipped)


def _typical(
    definition: Effect, rng: np.random.Generator, scale: ArmScale, joints: np.ndarray
) -> Values:
    """Values drawn evenly from the typical range, of the joints or of a vector's components independently."""
    per_joint = definition.scope == "joint"
    values = {}
    for parameter in definition.parameters:
        size = len(joints) if per_joint else parameter.size
        drawn = rng.uniform(*parameter.typical, size)
        values[parameter.name] = drawn if per_joint or size > 1 else drawn[0]
    return values
