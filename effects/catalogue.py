"""The catalogue: every effect that Gapscope knows, by name."""

from __future__ import annotations

from arm.errors import InputError
from effects.actuation import DELAY, OFFSET, SCALE
from effects.effect import Effect
from effects.friction import COULOMB, LOAD, VISCOUS
from effects.rigid_body import ARMATURE, PAYLOAD
from effects.sensing import ENCODER_OFFSET

CATALOGUE: dict[str, Effect] = {
    effect.name: effect for effect in (COULOMB, VISCOUS, LOAD, PAYLOAD, ARMATURE, SCALE, OFFSET, DELAY, ENCODER_OFFSET)
}


def effect(name: str) -> Effect:
    """The effect called ``name``.

    Raises:
        InputError: the catalogue has no such effect.
    """
    if name not in CATALOGUE:
        raise InputError(f"unknown effect {name!r}", f"use one of {', '.join(sorted(CATALOGUE))}")
    return CATALOGUE[name]
