"""Options that several commands take."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

from typer import Argument, Context, Option
from typer.models import ArgumentInfo, OptionInfo

_ROBOT = "kuka_iiwa, ..., a URDF, or a case with a data sheet"
_TRAJECTORY = "CSV to write; .yaml for ROS and .html with plots beside"

CasePath = Annotated[
    Path, Argument(help="folder of the case, or its case file", metavar="CASE")
]
Model = Annotated[
    Path | None,
    Option(help="corrected.yaml of a diagnosis; default: the nominal arm"),
]
Positive = Annotated[int, Option(min=1)]
NotNegative = Annotated[int, Option(min=0)]
File = Annotated[Path, Option(metavar="FILE")]
Folder = Annotated[Path, Option(metavar="DIR")]
Results = Annotated[Path, Option(help="folder for the results", metavar="DIR")]
RobotArgument = Annotated[str, Argument(help=_ROBOT, metavar="ROBOT")]
RobotOption = Annotated[str, Option(help=_ROBOT, metavar="ROBOT")]
Engine = Annotated[
    str | None,
    Option(
        help="pybullet or mujoco; default: pybullet if it is installed, else mujoco"
    ),
]

CaseOption = Annotated[Path | None, Option(metavar="CASE")]
RobotName = Annotated[str | None, Option(metavar="ROBOT")]
Names = Annotated[list[str] | None, Option(metavar="NAME")]
Csv = Annotated[Path, Option(metavar="FILE.csv")]
AsJson = Annotated[bool, Option(help="print JSON to standard output")]

# a trajectory within limits
Trajectory = Annotated[Path, Option(help=_TRAJECTORY, metavar="FILE")]
Rate = Annotated[float, Option(help="samples per second that are written [Hz]")]
SearchSeed = Annotated[int | None, Option(min=0, help="find the same trajectory again")]


def limit_plan(
    *,
    velocity: float = 1.5,
    acceleration: float = 5.0,
    torque: float = 0.8,
    margin: float = 0.1,
    singular: float = 0.02,
    clearance: float = 0.01,
    surface: float = 0.0,
    collisions: bool = True,
) -> Any:
    """The limits of a trajectory.

    Args:
        velocity: no joint moves faster [rad/s]
        acceleration: limit of every joint [rad/s^2]
        torque: share of the torque limits that may be used [1]
        margin: distance from the position limits [rad]
        singular: least singular value of the Jacobian [m/rad, 1]; 0 for any
        clearance: least distance between bodies and to the surface [m]
        surface: height of the surface under the arm, base frame [m]
        collisions: check collisions by the URDF's shapes, or boxes by its inertials
    """
    from gapscope.ident.excitation.design import LimitPlan

    return LimitPlan(
        velocity, acceleration, torque, margin, singular, clearance, surface, collisions
    )


Limits = Annotated[Any, limit_plan]
"""Options that several commands share: a parameter so annotated stands for those of the function."""

EffectsFrom = Annotated[
    list[Path] | None,
    Option(
        "--effects-from",
        help="Python file with effects of your own; may be given several times",
        metavar="FILE",
    ),
]


def as_command(
    function: Callable[..., Any], *, own_effects: bool
) -> Callable[..., Any]:
    """A command made from a function: what typer asks for stands in its signature and its docstring.

    Positional parameters are arguments, the others options; ``--name`` is the parameter's name, without an underscore
    at its end. The help is the docstring, that of a parameter its entry under ``Args:``.

    Args:
        function: of the command.
        own_effects: whether it takes ``--effects-from``: effects of such files take part in whatever it does.
    """
    groups = {
        name: function
        for name, annotation in _annotations(function).items()
        for function in _marks(annotation)
        if inspect.isfunction(function)
    }

    @wraps(function)
    def run(effects_from: Sequence[Path] | None = None, **options: Any) -> Any:
        # before the function looks anything up in the catalogue
        for file in effects_from or ():
            from gapscope.effects.catalogue import load_effects

            load_effects(file)
        for name, group in groups.items():
            # typer knows the options one by one, the function takes their group as one
            own = inspect.signature(group).parameters
            options[name] = group(**{key: options.pop(key) for key in own})
        return function(**options)

    parameters = list(_parameters(function))
    if own_effects:
        kind = inspect.Parameter.KEYWORD_ONLY
        parameters.append(
            inspect.Parameter(
                "effects_from", kind, default=None, annotation=EffectsFrom
            )
        )
    # typer reads the one or the other
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {own.name: own.annotation for own in parameters}
    run.__doc__ = _described(function)[0]
    return run


def _annotations(function: Callable[..., Any]) -> dict[str, Any]:
    """Annotations of the parameters, with all that they hold."""
    return get_type_hints(function, include_extras=True)


def _described(function: Callable[..., Any]) -> tuple[str, dict[str, str]]:
    """What a docstring says of a function, and of each of its parameters."""
    text = inspect.cleandoc(function.__doc__ or "")
    about, _, entries = text.partition("\n\nArgs:\n")
    # an entry begins with the name of its parameter, four spaces in; the lines below it stand farther in
    found = re.finditer(r"^    (\w+): (.*(?:\n {8}.*)*)", entries, re.MULTILINE)
    return about, {entry[1]: " ".join(entry[2].split()) for entry in found}


def _parameters(function: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    """The parameters of a function as typer takes them, those of its groups in their places."""
    full, (_, texts) = _annotations(function), _described(function)
    plain = get_type_hints(function)
    for name, own in inspect.signature(function).parameters.items():
        marks = list(_marks(full[name]))
        # typer gives the context by its type, without a mark
        if plain[name] is Context:
            yield own.replace(annotation=Context)
        # a group stands for the options of its function
        elif marks and inspect.isfunction(marks[0]):
            yield from _parameters(marks[0])
        else:
            asked = _asked(own, marks, texts.get(name))
            yield own.replace(annotation=Annotated[plain[name], asked])


def _asked(
    own: inspect.Parameter, marks: Sequence[OptionInfo | ArgumentInfo], text: str | None
) -> OptionInfo | ArgumentInfo:
    """What typer is told of a parameter: the mark in its annotation, if there is one, with name and help."""
    is_option = own.kind is own.KEYWORD_ONLY
    # marks are shared by commands: each gets its own name and help
    asked = copy(marks[0] if marks else Option() if is_option else Argument())
    asked.help = asked.help or text
    name = f"--{own.name.rstrip('_').replace('_', '-')}"
    # an option that is on by default is only of use with a way to turn it off
    if own.default is True:
        name = f"{name}/--no-{name[2:]}"
    if is_option:
        asked.param_decls = (name,)
    else:
        asked.metavar = asked.metavar or own.name.upper()
    return asked


def _marks(annotation: Any) -> Iterator[Any]:
    """What an annotation, or a part of it such as that of an optional value, is marked with."""
    yield from getattr(annotation, "__metadata__", ())
    for part in get_args(annotation):
        yield from _marks(part)


def split_names(text: str) -> tuple[str, ...]:
    """Names of an option that are separated by commas."""
    parts = (part.strip() for part in text.split(","))
    return tuple(name for name in parts if name)
