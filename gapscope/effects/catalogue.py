"""The catalogue: every effect that Gapscope knows, by name."""

from __future__ import annotations

from difflib import get_close_matches

from gapscope.arm.errors import InputError
from gapscope.effects.actuation import DELAY, LAG, OFFSET, RIPPLE, SATURATION, SCALE
from gapscope.effects.effect import Effect
from gapscope.effects.environment import BASE_TILT, EXTERNAL_FORCE
from gapscope.effects.friction import COULOMB, DRIFT, LOAD, STRIBECK, VISCOUS
from gapscope.effects.rigid_body import ARMATURE, LINK_INERTIA, PAYLOAD
from gapscope.effects.sensing import ENCODER_OFFSET, ENCODER_QUANTIZATION
from gapscope.effects.transmission import BACKLASH, ELASTICITY, SPRING

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        *(COULOMB, VISCOUS, STRIBECK, LOAD, DRIFT),
        *(PAYLOAD, LINK_INERTIA, ARMATURE, BASE_TILT),
        *(ELASTICITY, BACKLASH, RIPPLE, SPRING),
        *(SCALE, OFFSET, SATURATION, LAG, DELAY),
        *(ENCODER_OFFSET, ENCODER_QUANTIZATION, EXTERNAL_FORCE),
    )
}


def effect(name: str) -> Effect:
    """The effect called ``name``.

    Raises:
        InputError: the catalogue has no such effect; offers the nearest name.
    """
    if name not in CATALOGUE:
        near = get_close_matches(name, CATALOGUE, n=1, cutoff=0.5)
        known = f"use one of {', '.join(sorted(CATALOGUE))}"
        raise InputError(
            f"unknown effect {name!r}",
            f"did you mean {near[0]}? Or {known}" if near else known,
        )
    return CATALOGUE[name]
