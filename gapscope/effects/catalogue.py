"""The catalogue: every effect of Gapscope, by name, and the effects of users.

A user's effects come from a file that ``load_effects`` reads, from an installed package, or from ``register``. Files
are named in the environment variable ``GAPSCOPE_EFFECTS`` as well, and read when a process first imports the
catalogue: so every process that this one starts, on this machine or by Ray, has them too.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import read_text
from gapscope.arm.nearest_name import nearest
from gapscope.effects.actuation import DELAY, LAG, OFFSET, RIPPLE, SATURATION, SCALE
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
from gapscope.effects.own_effects import (
    PAGE,
    check_effect,
    effects_of,
    installed_effects,
    run_file,
)
from gapscope.effects.parametrisation import linear_in
from gapscope.effects.rigid_body import ARMATURE, LINK_INERTIA, PAYLOAD
from gapscope.effects.sensing import ENCODER_OFFSET, ENCODER_QUANTIZATION
from gapscope.effects.transmission import BACKLASH, ELASTICITY, SPRING

# Rotor and friction of motors that turn several joints, as in a wrist: those of a joint, taken at the motor.
#
# Motor m turns at w = D_m dq, D_m [1] the row of the arm's coupling, on the side of the joint of its own number, and
# its torque acts on the joints along D_m^T. ``joints`` of these effects are the numbers of the motors. They exist on
# arms whose case declares a coupling.


_ALONE = "the joints of the motor one at a time, then against each other"


def _of_motor(effect: Effect, equation: str, looks_like: str) -> Effect:
    """The effect of a joint as one of a motor; a diagnosis looks for those of one parameter."""
    alone = len(effect.parameters) == 1
    return replace(
        effect,
        name=f"coupled_{effect.name}",
        equation=equation,
        looks_like=looks_like,
        confused_with=((effect.name, _ALONE),),
        on_joint=effect.name,
        parametrisation=linear_in(effect.parameters[0], lowest=0.0) if alone else None,
        severity=None,
        reach="motor",
        plotted_against="own torque",
        quantities={name: f"motor_{own}" for name, own in effect.quantities.items()},
        without="",
    )


COUPLED_MOTORS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        _of_motor(
            COULOMB,
            "D^T c sgn(D dq)",
            "a step of the torque of all joints of one motor, where the motor turns round",
        ),
        _of_motor(
            VISCOUS,
            "D^T b D dq",
            "a torque on all joints of one motor, linear in the motor's speed",
        ),
        _of_motor(
            ARMATURE,
            "D^T I D ddq",
            "a torque on all joints of one motor, proportional to the motor's acceleration",
        ),
        _of_motor(
            STRIBECK,
            "D^T d exp(-(D dq / vs)^2) sgn(D dq)",
            "friction of a motor that falls as it begins to move",
        ),
        _of_motor(
            SATURATING,
            "D^T d tanh(|D dq| / vs) sgn(D dq)",
            "friction of a motor that grows with its speed, less and less",
        ),
    )
}
"""Effects of coupled motors by name; the catalogue is for arms of any kind and does without them.

A diagnosis looks for the first three; the others come from an identification.
"""


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


SHIPPED = frozenset(CATALOGUE) | frozenset(COUPLED_MOTORS)
"""Names of the effects that come with the package."""
FILES = "GAPSCOPE_EFFECTS"
"""Environment variable with the files of effects that this process and those it starts have, as in PATH."""


class _OwnFile(NamedTuple):
    """A file of effects: its text when it was read, and what it brought."""

    text: str
    effects: tuple[Effect, ...]


_files: dict[Path, _OwnFile] = {}
_packages: dict[str, str] = {}


def register(new: Effect) -> Effect:
    """Enter an effect into the catalogue of this process alone, so that it can be simulated, predicted and diagnosed.

    ``load_effects`` reads it from a file, for the processes that this one starts too.

    Returns:
        The effect.

    Raises:
        InputError: the catalogue has an effect of this name, or the effect cannot be used.
    """
    # the same record once more, as when a file is imported twice, is no clash
    if known_effect(new.name) is new:
        return new
    check_effect(new)
    if known_effect(new.name) is not None:
        raise InputError(
            f"the catalogue has an effect called {new.name!r}",
            "give the effect another name, or remove the other one first",
        )
    CATALOGUE[new.name] = new
    return new


def load_effects(file: Path | str) -> tuple[Effect, ...]:
    """Enter the effects of a Python file into the catalogue: the records at its top level, and what it registers.

    A file that has been read before is read again if it was changed.

    Args:
        file: the file; it is run, as ``import`` would.

    Returns:
        The effects.

    Raises:
        InputError: the file cannot be run, holds no effect, or one of a name that is taken or with a law that cannot be
            used.

    Examples:
        >>> import gapscope
        >>> gapscope.load_effects("cable_drag.py")  # doctest: +SKIP
    """
    path = Path(os.path.abspath(Path(file).expanduser()))
    text = read_text(path, f"give a Python file with an effect: {PAGE}")
    # out of the list while it is read: a file that fails is not in it
    earlier = _files.pop(path, None)
    if earlier is not None:
        if earlier.text == text and all(map(_is_entered, earlier.effects)):
            _files[path] = earlier
            return earlier.effects
        # what has taken its name since is not the file's to remove
        for old in filter(_is_entered, earlier.effects):
            remove(old.name)
    others = list(CATALOGUE.values())
    try:
        module = run_file(path)
        named = [one for one in effects_of(module) if one not in others]
        for one in named:
            _enter(one, path)
        # what the file registered itself counts too
        entered = tuple(one for one in CATALOGUE.values() if one not in others)
        if not entered:
            raise InputError(
                "holds no effect",
                f"define one at the top level, such as MY_EFFECT = TorqueLaw(...): {PAGE}",
                file=path,
            )
    except InputError:
        # all of a file or nothing
        for one in [one for one in CATALOGUE.values() if one not in others]:
            remove(one.name)
        raise
    _files[path] = _OwnFile(text, entered)
    _pass_files_on()
    return entered


def _pass_files_on() -> None:
    """Name the files of this process to those that it starts."""
    # an empty list too: processes begun later must not have what was removed
    if _files or FILES in os.environ:
        os.environ[FILES] = os.pathsep.join(map(str, _files))


def _is_entered(one: Effect) -> bool:
    return CATALOGUE.get(one.name) is one


def _enter(one: Effect, path: Path) -> None:
    """Register an effect of a file, which errors name."""
    try:
        register(one)
    except InputError as error:
        raise error.at(path) from None


def own_sources() -> list[tuple[str, str]]:
    """What effects of users were read from: names and texts of files, names and versions of packages."""
    files = [(path.name, own.text) for path, own in _files.items()]
    return [*files, *_packages.items()]


def remove(name: str) -> Effect:
    """Take an effect out of the catalogue of this process, and return it.

    Raises:
        InputError: the catalogue has no such effect.
    """
    removed = effect(name)
    CATALOGUE.pop(name, None)
    # a file that lost an effect is read again when it is asked for
    for path in [path for path, own in _files.items() if removed in own.effects]:
        del _files[path]
    _pass_files_on()
    return removed


@contextmanager
def without(names: Collection[str]) -> Iterator[None]:
    """The catalogue of this process without some effects; afterwards all of it, in its order."""
    # a copy: what is put back has its old order
    all_of_them = dict(CATALOGUE)
    for name in names:
        CATALOGUE.pop(name, None)
    try:
        yield
    finally:
        CATALOGUE.clear()
        CATALOGUE.update(all_of_them)


def explained(*, coupled: bool = False) -> list[Effect]:
    """Effects that a diagnosis can find by the torque gap, in the order of their terms.

    ``coupled`` says whether the arm has motors that turn several joints; their effects come last.

    The order is the catalogue's, but for load friction, which comes before Stribeck friction: random numbers of the
    reported standard deviations depend on it.
    """
    names = list(CATALOGUE)
    # users may take either of them out
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
        # an effect of a user is unknown in a process that did not read its file
        near = nearest(name, [*CATALOGUE, *COUPLED_MOTORS])
        known_names = f"use one of {', '.join(sorted(CATALOGUE))}"
        raise InputError(
            f"unknown effect {name!r}",
            f"{near}If it is an effect of your own: did you forget --effects-from FILE, or gapscope.load_effects(FILE) "
            f"in Python? Else {known_names}",
        )
    return known


# what this process has from the start: of installed packages, and of files that the process that started it had
for _package, _version, _effect in installed_effects():
    register(_effect)
    _packages[_package] = _version
for _file in filter(None, os.environ.get(FILES, "").split(os.pathsep)):
    try:
        load_effects(_file)
    except InputError as error:
        raise error.at(Path(_file), f"named in {FILES}") from None
