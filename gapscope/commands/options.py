"""Options that several commands take."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

_ROBOT = "kuka_iiwa, ..., a URDF, or a case with a data sheet"
_TRAJECTORY = "CSV to write; .yaml for ROS and .html with plots beside"

CasePath = Annotated[
    Path, Argument(help="folder of the case, or its case file", metavar="CASE")
]
Model = Annotated[
    Path | None,
    Option(help="corrected.yaml of a diagnosis; default: the nominal arm"),
]
Results = Annotated[Path, Option(help="folder for the results", metavar="DIR")]
RobotArgument = Annotated[str, Argument(help=_ROBOT, metavar="ROBOT")]
RobotOption = Annotated[str, Option(help=_ROBOT, metavar="ROBOT")]
Engine = Annotated[
    str | None,
    Option(
        help="pybullet or mujoco; default: pybullet if it is installed, else mujoco"
    ),
]

AsJson = Annotated[bool, Option("--json", help="print JSON to standard output")]

# a trajectory within limits
Trajectory = Annotated[Path, Option(help=_TRAJECTORY, metavar="FILE")]
Rate = Annotated[float, Option(help="samples per second that are written [Hz]")]
Velocity = Annotated[float, Option(help="no joint moves faster [rad/s]")]
Acceleration = Annotated[float, Option(help="limit of every joint [rad/s^2]")]
Torque = Annotated[
    float, Option(help="share of the torque limits that may be used [1]")
]
Margin = Annotated[float, Option(help="distance from the position limits [rad]")]
Singular = Annotated[
    float,
    Option(help="least singular value of the Jacobian [m/rad, 1]; 0 for any"),
]
Clearance = Annotated[
    float, Option(help="least distance between bodies and to the surface [m]")
]
Surface = Annotated[
    float, Option(help="height of the surface under the arm, base frame [m]")
]
Collisions = Annotated[
    bool,
    Option(help="check collisions by the URDF's shapes, or boxes by its inertials"),
]
SearchSeed = Annotated[int | None, Option(min=0, help="find the same trajectory again")]

EffectsFrom = Annotated[
    list[Path] | None,
    Option(
        "--effects-from",
        help="Python file with effects of your own; may be given several times",
        metavar="FILE",
    ),
]


def with_own_effects(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with the option ``--effects-from``: effects of such files take part in whatever it does."""
    own = inspect.signature(command, eval_str=True)

    @wraps(command)
    def run(*, effects_from: list[Path] | None = None, **options: Any) -> Any:
        if effects_from:
            from gapscope.effects.catalogue import load_effects

            for file in effects_from:
                load_effects(file)
        return command(**options)

    kind = inspect.Parameter.KEYWORD_ONLY
    added = inspect.Parameter(
        "effects_from", kind, default=None, annotation=EffectsFrom
    )
    signature = own.replace(parameters=[*own.parameters.values(), added])
    # typer reads the one or the other
    run.__signature__ = signature  # type: ignore[attr-defined]
    run.__annotations__ = {
        name: parameter.annotation for name, parameter in signature.parameters.items()
    }
    return run


def split_names(text: str) -> tuple[str, ...]:
    """Names of an option that are separated by commas."""
    parts = (part.strip() for part in text.split(","))
    return tuple(name for name in parts if name)
