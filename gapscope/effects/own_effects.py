"""Effects that do not come with the package: read from a Python file or an installed package, and checked.

A law is computed on a few samples before it is entered: one that does not broadcast, or is not finite, is refused with
its name here, not with a traceback in the middle of a diagnosis.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import read_text
from gapscope.arm.motions.motion import Motion
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import (
    QUANTITIES,
    Drift,
    DryLaw,
    Effect,
    External,
    LinkChange,
    Sensing,
    Signals,
    TorqueLaw,
    Transmission,
    Turn,
)
from gapscope.effects.effect import (
    Path as WayToJoint,
)
from gapscope.effects.signals import MotionSeries

GROUP = "gapscope.effects"
"""Entry points by which an installed package brings effects: a record, several, or a module that holds some."""
PAGE = "docs/own_effect.md shows a whole file"
FAMILIES = (
    "friction",
    "rigid_body",
    "transmission",
    "actuation",
    "sensing",
    "environment",
)
KINDS = (
    *(TorqueLaw, Drift, LinkChange, Turn, Transmission),
    *(WayToJoint, Sensing, External),
)
"""Kinds of effects that act by a law of their own."""
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_N, _JOINTS = 6, 3
"""Samples and joints of the trial: different numbers, none of them one, so that a wrong shape shows."""


def run_file(path: Path) -> ModuleType:
    """A Python file, run as a module that later imports find.

    Raises:
        InputError: there is no such file, it is not Python, or it fails while it is run; names the line.
    """
    text = read_text(path, f"give a Python file with an effect: {PAGE}")
    # by its path: files of one name in two folders are two modules, the same in every process
    module = ModuleType(f"{path.stem}_{crc32(str(path).encode()):08x}")
    module.__file__ = str(path)
    # before it is run: dataclasses and pickles look their module up by its name
    sys.modules[module.__name__] = module
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except SyntaxError as error:
        raise InputError(
            f"is not valid Python: {error.msg}",
            f"correct the line; {PAGE}",
            file=path,
            where=f"line {error.lineno}",
        ) from None
    except InputError as error:
        raise error.at(path) from None
    # a file may end itself: that is no reason to end this process
    except (Exception, SystemExit) as error:
        raise InputError(
            f"fails while it is read ({type(error).__name__}: {error})",
            f"run it with python to see more; {PAGE}",
            file=path,
            where=_line(path, error),
        ) from error
    return module


def _line(path: Path, error: BaseException) -> str:
    """The last line of the file that an exception went through."""
    # the last one in the file: what is called from it lies elsewhere
    trace, line = error.__traceback__, 0
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"line {line}" if line else ""


def effects_of(value: Any) -> list[Effect]:
    """The effects that a value is or holds: a record, several, or a module with records at its top level."""
    if isinstance(value, Effect):
        return [value]
    held = vars(value).values() if isinstance(value, ModuleType) else value
    if not isinstance(held, Iterable):
        return []
    found: list[Effect] = []
    for item in held:
        # by identity: one record under two names is one effect
        if isinstance(item, Effect) and all(item is not other for other in found):
            found.append(item)
    return found


def installed_effects() -> Iterator[tuple[str, str, Effect]]:
    """Name and version of each installed package that brings effects, and the effect.

    Raises:
        InputError: an entry point cannot be loaded, or brings none.
    """
    # in one order: entry points come as the machine has installed them
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        package = point.dist.name if point.dist else point.value
        version = point.dist.version if point.dist else ""
        remedy = f"repair or uninstall the package {package}"
        try:
            found = effects_of(point.load())
        except Exception as error:
            raise InputError(
                f"the effects of the package {package} cannot be loaded ({type(error).__name__}: {error})",
                remedy,
                where=f"entry point {point.value}",
            ) from error
        if not found:
            raise InputError(
                f"the package {package} brings no effect",
                f"let the entry point name an Effect, a list of them, or a module that holds some; or {remedy}",
                where=f"entry point {point.value}",
            )
        for record in found:
            yield package, version, record


def check_effect(effect: Effect) -> None:
    """Check that an effect can be simulated, predicted, fitted and reported.

    Raises:
        InputError: it cannot; says what is expected, and what to do.
    """
    _check_record(effect)
    _check_values(effect)
    with np.errstate(all="ignore"):
        for trial in _trials(effect):
            _check_law(effect, trial)


def _refused(effect: Effect, part: str, problem: str, remedy: str) -> InputError:
    """The error that a part of an effect is at fault."""
    return InputError(problem, remedy, where=f"{effect.name}.{part}".rstrip("."))


def _check_record(effect: Effect) -> None:
    """Check the names, the kind, the family and the ranges."""
    for name in (effect.name, *effect.names):
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise _refused(
                effect,
                "",
                f"{name!r} is no name for files and commands",
                "use snake case: small letters, digits and underscores, as in cogging_torque",
            )
    kind = type(effect).__name__
    # a record without a law does nothing anywhere
    if not isinstance(effect, KINDS):
        names = ", ".join(known.__name__ for known in KINDS)
        raise _refused(effect, "", f"{kind} has no law", f"make it one of {names}")
    # where a kind of effect can act follows from what its law takes
    scopes: tuple[str, ...] = ("joint",)
    if isinstance(effect, LinkChange):
        scopes = ("link", "arm")
    elif isinstance(effect, External | Turn):
        scopes = ("arm",)
    for part, known in (("family", FAMILIES), ("scope", scopes)):
        if getattr(effect, part) not in known:
            problem = f"a {kind} of {part} {getattr(effect, part)!r}"
            raise _refused(effect, part, problem, f"use {' or '.join(known)}")
    for p in effect.parameters:
        (low, high), (least, most) = p.bounds, p.typical
        if not low <= least <= most <= high or least == most == 0.0:
            raise _refused(
                effect,
                p.name,
                f"typical values {p.typical} within bounds {p.bounds} {p.unit}",
                "give the smallest first, typical ones within the bounds and not all zero",
            )
    for name, quantity in effect.quantities.items():
        if name not in effect.names or quantity not in QUANTITIES:
            raise _refused(
                effect,
                "quantities",
                f"{name!r}: {quantity!r} is no quantity of a parameter",
                f"name a parameter, and one of {', '.join(QUANTITIES)}",
            )


def _check_values(effect: Effect) -> None:
    """Check that fitting and drawing give the parameters, and that a search for one has a place to begin."""
    fit, draw, given = effect.parametrisation, effect.severity, {}
    if fit is not None:
        # other kinds begin with starts of their own
        on_grid = isinstance(effect, TorqueLaw | Drift) and bool(fit.nonlinear)
        if on_grid and (fit.grid is None or len(fit.nonlinear) > 1):
            raise _refused(
                effect,
                "parametrisation",
                f"no Grid says where the search for {', '.join(fit.nonlinear)} begins",
                "give one nonlinear parameter, and a Grid of the values to try first",
            )
        x = np.ones((fit.linear, 1)), np.ones((len(fit.nonlinear), 1))
        given["parametrisation"] = partial(fit.values, *x)
    if draw is not None:
        ones = np.ones(_JOINTS)
        # a unit of everything: only names and shapes are looked at
        scale = ArmScale(ones, ones, ones, ones, ones, 1.0)
        joints = np.arange(_JOINTS if effect.scope == "joint" else 0)
        given["severity"] = partial(draw, np.random.default_rng(0), scale, joints)
    # on which link it acts is searched beside its values
    searched = {"link"} if effect.scope == "link" else set()
    for part, values_of in given.items():
        try:
            names = set(values_of())
        except Exception as error:
            raise _refused(
                effect,
                part,
                f"cannot be computed ({type(error).__name__}: {error})",
                f"let it give a value of {', '.join(effect.names)}; {PAGE}",
            ) from error
        if not set(effect.needed) <= names | searched <= set(effect.names):
            raise _refused(
                effect,
                part,
                f"gives {', '.join(sorted(names)) or 'nothing'}, but the parameters are {', '.join(effect.names)}",
                "let it give a value of each parameter",
            )


class _Trial(NamedTuple):
    """A law of an effect with samples.

    Attributes:
        name: of the law.
        takes: what it takes before its parameters, in words.
        arguments: the same, of the rows that are asked for.
        without: its values without the effect, (N, n).
    """

    name: str
    takes: str
    arguments: Callable[[Any], tuple[Any, ...]]
    without: np.ndarray


def _trials(effect: Effect) -> list[_Trial]:
    """The laws of an effect on joints, each with samples. Of those on links and arms, the record alone is checked."""
    rng = np.random.default_rng(0)
    q, dq, load = rng.uniform(-2.0, 2.0, (3, _N, _JOINTS))
    # where laws divide by zero
    dq[0] = load[1] = q[2] = 0.0
    t = np.linspace(0.0, 1.0, _N)
    none, time = np.zeros((_N, _JOINTS)), t[:, None]
    # a series is needed whole, as for delays
    way = load, MotionSeries(Motion(t, q, dq, dq))

    def signals(k: Any) -> tuple[Signals]:
        return (Signals(time[k], q[k], dq[k], load[k]),)

    place, recorded = "position [rad]", "the torque recorded [N m], a Series"
    known = {
        TorqueLaw: [_Trial("law", "Signals", signals, none)],
        DryLaw: [
            _Trial(
                *("amplitude", "velocity [rad/s], load [N m]"),
                lambda k: (dq[k], load[k]),
                none,
            )
        ],
        Drift: [_Trial("change", "time [s]", lambda k: (time[k],), none)],
        Transmission: [
            _Trial("deflection", "torque [N m]", lambda k: (load[k],), none)
        ],
        Sensing: [
            _Trial("true", place, lambda k: (q[k],), q),
            _Trial("recorded", place, lambda k: (q[k],), q),
        ],
        WayToJoint: [
            _Trial("inverse", "the torque needed, a Series", lambda k: way, load),
            _Trial("applied", recorded, lambda k: way, load),
        ],
    }
    return [x for kind in known if isinstance(effect, kind) for x in known[kind]]


def _check_law(effect: Effect, trial: _Trial) -> None:
    """Check a law with typical values of the parameters, with one sample alone, and without the effect."""
    law, without = getattr(effect, trial.name), trial.without
    # another value on each joint, so that a law that mixes joints shows
    typical = [np.linspace(*p.typical, _JOINTS) for p in effect.parameters]
    refused = partial(_refused, effect, trial.name)

    def computed(rows: Any, values: Iterable[np.ndarray]) -> np.ndarray:
        try:
            result = np.asarray(law(*trial.arguments(rows), *values), dtype=float)
        except Exception as error:
            raise refused(
                f"cannot be computed ({type(error).__name__}: {error})",
                f"let it take {trial.takes} and the parameters {', '.join(effect.names)}, in this order; it gets "
                f"arrays and uses functions of numpy: {PAGE}",
            ) from error
        # a law may give less than that, as long as it broadcasts
        wanted = without[rows].shape
        try:
            return np.broadcast_to(result, wanted)
        except ValueError:
            raise refused(
                f"gives an array of shape {result.shape}, expected {wanted}: one value for each sample and joint",
                "compute each sample and joint by itself, without sums or indices over them",
            ) from None

    series = computed(slice(None), typical)
    if not np.isfinite(series).all():
        raise refused(
            "gives nan or infinity for typical values of its parameters",
            "keep what it divides by away from zero, and powers of negative numbers out",
        )
    # what lies on the way may need a series: one sample is no trial for it
    for row in range(0 if isinstance(effect, WayToJoint) else _N):
        if not np.allclose(computed(row, typical), series[row], atol=1e-9):
            raise refused(
                "gives another value for one sample alone than for the same sample in a series",
                "let a sample depend on nothing but its own signals and the parameters",
            )
    off = computed(slice(None), np.zeros((len(typical), _JOINTS)))
    wrong = off[~np.isclose(off, without, rtol=0.0, atol=1e-9)]
    if wrong.size:
        raise refused(
            f"gives {wrong[0]:g} where every parameter is zero, as on joints that do not have the effect",
            "let it do nothing there: multiply by an amplitude, and divide by gapscope.effects.parametrisation.nonzero"
            "(x)",
        )
