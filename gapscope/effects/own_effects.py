"""Effects that do not come with the package: read from a Python file or an installed package, and checked.

A law is computed on a few samples before it is entered: one that does not broadcast, or is not finite, is refused with
its name here, not with a traceback in the middle of a diagnosis.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any
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
        if isinstance(item, Effect) and all(item is not other for other in found):
            found.append(item)
    return found


def installed_effects() -> Iterator[tuple[str, str, Effect]]:
    """Name and version of each installed package that brings effects, and the effect.

    Raises:
        InputError: an entry point cannot be loaded, or brings none.
    """
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
    _check_parametrisation(effect)
    with np.errstate(all="ignore"):
        for trial in _trials(effect):
            _check_law(effect, *trial)


def _check_record(effect: Effect) -> None:
    """Check the names, the kind, the family and the ranges."""

    def refuse(problem: str, remedy: str, where: str = "") -> InputError:
        place = f"{effect.name}.{where}" if where else str(effect.name)
        return InputError(problem, remedy, where=place)

    for name in (effect.name, *effect.names):
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise refuse(
                f"{name!r} is no name for files and commands",
                "use snake case: small letters, digits and underscores, as in cogging_torque",
            )
    if not isinstance(effect, KINDS):
        names = ", ".join(kind.__name__ for kind in KINDS)
        raise refuse(f"{type(effect).__name__} has no law", f"make it one of {names}")
    if effect.family not in FAMILIES:
        raise refuse(
            f"unknown family {effect.family!r}",
            f"use one of {', '.join(FAMILIES)}",
            "family",
        )
    scopes: dict[type[Effect], tuple[str, ...]] = {
        LinkChange: ("link", "arm"),
        External: ("arm",),
        Turn: ("arm",),
    }
    allowed = next((s for k, s in scopes.items() if isinstance(effect, k)), ("joint",))
    if effect.scope not in allowed:
        raise refuse(
            f"a {type(effect).__name__} of scope {effect.scope!r}",
            f"use {' or '.join(allowed)}",
            "scope",
        )
    for p in effect.parameters:
        (low, high), (least, most) = p.bounds, p.typical
        if not low <= least <= most <= high or least == most == 0.0:
            raise refuse(
                f"typical values {p.typical} within bounds {p.bounds} {p.unit}",
                "give the smallest first, typical ones within the bounds and not all zero",
                p.name,
            )
    for name, quantity in effect.quantities.items():
        if name not in effect.names or quantity not in QUANTITIES:
            raise refuse(
                f"{name!r}: {quantity!r} is no quantity of a parameter",
                f"name a parameter, and one of {', '.join(QUANTITIES)}",
                "quantities",
            )


def _check_parametrisation(effect: Effect) -> None:
    """Check that fitting and drawing give the parameters, and that a search for one has a place to begin."""
    fit, given = effect.parametrisation, {}
    if fit is not None:
        on_grid = isinstance(effect, TorqueLaw | Drift) and bool(fit.nonlinear)
        if on_grid and (fit.grid is None or len(fit.nonlinear) > 1):
            raise InputError(
                f"no Grid says where the search for {', '.join(fit.nonlinear)} begins",
                "give one nonlinear parameter, and a Grid of the values to try first",
                where=f"{effect.name}.parametrisation",
            )
        x, s = np.ones((fit.linear, 1)), np.ones((len(fit.nonlinear), 1))
        given["parametrisation"] = lambda: fit.values(x, s)
    if effect.severity is not None:
        draw, ones = effect.severity, np.ones(_JOINTS)
        scale = ArmScale(ones, ones, ones, ones, ones, 1.0)
        joints = np.arange(_JOINTS if effect.scope == "joint" else 0)
        rng = np.random.default_rng(0)
        given["severity"] = lambda: draw(rng, scale, joints)
    for what, values_of in given.items():
        where = f"{effect.name}.{what}"
        try:
            names = set(values_of())
        except Exception as error:
            raise InputError(
                f"cannot be computed ({type(error).__name__}: {error})",
                f"let it give a value of {', '.join(effect.names)}; {PAGE}",
                where=where,
            ) from error
        # on which link it acts is searched beside its values
        searched = {"link"} if effect.scope == "link" else set()
        if names | searched != set(effect.names):
            raise InputError(
                f"gives {', '.join(sorted(names)) or 'nothing'}, but the parameters are {', '.join(effect.names)}",
                "let it give a value of each parameter",
                where=where,
            )


Trial = tuple[str, Callable[..., Any], Callable[[Any], tuple[Any, ...]], np.ndarray]
"""Name of a law; the law; what it takes before its parameters, from the rows that it is asked for; its values without
the effect, shape (N, n)."""


def _trials(effect: Effect) -> Iterator[Trial]:
    """The laws of an effect on joints, each with samples. Of those on links and arms, the record alone is checked."""
    rng = np.random.default_rng(0)
    q, dq, load = rng.uniform(-2.0, 2.0, (3, _N, _JOINTS))
    # where laws divide by zero
    dq[0] = load[1] = q[2] = 0.0
    t = np.linspace(0.0, 1.0, _N)
    none = np.zeros((_N, _JOINTS))
    time = t[:, None]
    if isinstance(effect, TorqueLaw):
        yield (
            "law",
            effect.law,
            lambda k: (Signals(time[k], q[k], dq[k], load[k]),),
            none,
        )
    if isinstance(effect, DryLaw):
        # without the effect its amplitude is zero as well
        yield "amplitude", effect.amplitude, lambda k: (dq[k], load[k]), none
    if isinstance(effect, Drift):
        yield "change", effect.change, lambda k: (time[k],), none
    if isinstance(effect, Transmission):
        yield "deflection", effect.deflection, lambda k: (load[k],), none
    if isinstance(effect, Sensing):
        yield "true", effect.true, lambda k: (q[k],), q
        yield "recorded", effect.recorded, lambda k: (q[k],), q
    if isinstance(effect, WayToJoint):
        series = MotionSeries(Motion(t, q, dq, dq))
        # a series is needed whole, as for delays
        yield "inverse", effect.inverse, lambda k: (load, series), load
        yield "applied", effect.applied, lambda k: (load, series), load


def _check_law(
    effect: Effect,
    what: str,
    law: Callable[..., Any],
    arguments: Callable[[Any], tuple[Any, ...]],
    without: np.ndarray,
) -> None:
    """Check a law with typical values of the parameters, with one sample alone, and without the effect."""
    where = f"{effect.name}.{what}"
    typical = [np.linspace(*p.typical, _JOINTS) for p in effect.parameters]
    absent = [np.zeros(_JOINTS) for _ in effect.parameters]
    every = slice(None)

    def computed(rows: Any, values: Iterable[np.ndarray]) -> np.ndarray:
        try:
            result = np.asarray(law(*arguments(rows), *values), dtype=float)
        except Exception as error:
            raise InputError(
                f"cannot be computed ({type(error).__name__}: {error})",
                f"let it take {_taken(what)} and the parameters {', '.join(effect.names)}, in this order; it gets "
                f"arrays and uses functions of numpy: {PAGE}",
                where=where,
            ) from error
        wanted = without[rows].shape
        try:
            return np.broadcast_to(result, wanted)
        except ValueError:
            raise InputError(
                f"gives an array of shape {result.shape}, expected {wanted}: one value for each sample and joint",
                "compute each sample and joint by itself, without sums or indices over them",
                where=where,
            ) from None

    series = computed(every, typical)
    if not np.isfinite(series).all():
        raise InputError(
            "gives nan or infinity for typical values of its parameters",
            "keep what it divides by away from zero, and powers of negative numbers out",
            where=where,
        )
    if not isinstance(effect, WayToJoint):
        for row in range(_N):
            if not np.allclose(computed(row, typical), series[row], atol=1e-9):
                raise InputError(
                    "gives another value for one sample alone than for the same sample in a series",
                    "let a sample depend on nothing but its own signals and the parameters",
                    where=where,
                )
    off = computed(every, absent)
    if not np.allclose(off, without, rtol=0.0, atol=1e-9):
        found = off[~np.isclose(off, without, rtol=0.0, atol=1e-9)][0]
        raise InputError(
            f"gives {found:g} where every parameter is zero, as on joints that do not have the effect",
            "let it do nothing there: multiply by an amplitude, and divide by gapscope.effects.parametrisation.nonzero"
            "(x)",
            where=where,
        )


def _taken(what: str) -> str:
    """What a law takes before its parameters, in words."""
    taken: Mapping[str, str] = {
        "law": "Signals",
        "amplitude": "velocity [rad/s], load [N m]",
        "change": "time [s]",
        "deflection": "torque [N m]",
        "inverse": "the torque needed [N m], a Series",
        "applied": "the torque recorded [N m], a Series",
    }
    return taken.get(what, "position [rad]")
