"""The catalogue: every effect of Gapscope, by name; others can be entered with ``register``."""

from __future__ import annotations

from difflib import get_close_matches

from gapscope.arm.errors import InputError
from gapscope.effects.actuation import DELAY, LAG, OFFSET, RIPPLE, SATURATION, SCALE
from gapscope.effects.coupled_motors import COUPLED_MOTORS
from gapscope.effects.effect import Effect
from gapscope.effects.environment import BASE_TILT, EXTERNAL_FORCE
from gapscope.effects.friction import (
    COULOMB,
    DRIFT,
    LOAD,
    SATURATING,
    STRIBECK,
    VISCOUS,
)
from gapscope.effects.rigid_body import ARMATURE, LINK_INERTIA, PAYLOAD
from gapscope.effects.sensing import ENCODER_OFFSET, ENCODER_QUANTIZATION
from gapscope.effects.transmission import BACKLASH, ELASTICITY, SPRING

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        *(COULOMB, VISCOUS, STRIBECK, SATURATING, LOAD, DRIFT),
        *(PAYLOAD, LINK_INERTIA, ARMATURE, BASE_TILT),
        *(ELASTICITY, BACKLASH, RIPPLE, SPRING),
        *(SCALE, OFFSET, SATURATION, LAG, DELAY),
        *(ENCODER_OFFSET, ENCODER_QUANTIZATION, EXTERNAL_FORCE),
    )
}


def register(new: Effect) -> Effect:
    """Enter an effect into the catalogue of this process, so that it can be simulated, predicted, and diagnosed.

    A process that is started later, as by ``diagnose --jobs``, does not have it unless it imports the same file.

    Returns:
        The effect.

    Raises:
        InputError: the catalogue has an effect of this name.
    """
    if new.name in CATALOGUE or new.name in COUPLED_MOTORS:
        raise InputError(
            f"the catalogue has an effect called {new.name!r}",
            "give the effect another name, or remove the other one first",
        )
    CATALOGUE[new.name] = new
    return new


def remove(name: str) -> Effect:
    """Take an effect out of the catalogue of this process, and return it.

    Raises:
        InputError: the catalogue has no such effect.
    """
    removed = effect(name)
    CATALOGUE.pop(name, None)
    return removed


def explained(*, coupled: bool = False) -> list[Effect]:
    """Effects that a diagnosis can find by the torque gap, in the order of their terms.

    ``coupled`` says whether the arm has motors that turn several joints; their effects come last.

    The order is the catalogue's, but for load friction, which comes before Stribeck friction: random numbers of the
    reported standard deviations depend on it.
    """
    names = list(CATALOGUE)
    if {LOAD.name, STRIBECK.name} <= CATALOGUE.keys():
        names.remove(LOAD.name)
        names.insert(names.index(STRIBECK.name), LOAD.name)
    shown = [CATALOGUE[name] for name in names]
    if coupled:
        shown += COUPLED_MOTORS.values()
    return [each for each in shown if each.parametrisation is not None]


def of_quantity(quantity: str) -> tuple[Effect, str]:
    """The first effect with a parameter that is a key of ``QUANTITIES``, and that parameter's name."""
    return next(
        (effect, parameter)
        for effect in (*CATALOGUE.values(), *COUPLED_MOTORS.values())
        for parameter, own in effect.quantities.items()
        if own == quantity
    )


def known_effect(name: str) -> Effect | None:
    """The effect called ``name``; ``None`` for a fault of the set-up, or an effect that this process does not know."""
    return CATALOGUE.get(name) or COUPLED_MOTORS.get(name)


def effect(name: str) -> Effect:
    """The effect called ``name``, of the catalogue or of coupled motors.

    Raises:
        InputError: the catalogue has no such effect; offers the nearest name.
    """
    known = known_effect(name)
    if known is None:
        near = get_close_matches(name, [*CATALOGUE, *COUPLED_MOTORS], n=1, cutoff=0.5)
        names = f"use one of {', '.join(sorted(CATALOGUE))}"
        raise InputError(
            f"unknown effect {name!r}",
            f"did you mean {near[0]}? Or {names}" if near else names,
        )
    return known
