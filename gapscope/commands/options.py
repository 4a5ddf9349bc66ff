"""Options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_ROBOT = "kuka_iiwa, ..., a URDF, or a case with a data sheet"
_TRAJECTORY = "CSV to write; .yaml for ROS and .html with plots beside"

CasePath = Annotated[
    Path, typer.Argument(help="folder of the case, or its case file", metavar="CASE")
]
Model = Annotated[
    Path | None,
    typer.Option(help="corrected.yaml of a diagnosis; default: the nominal arm"),
]
Results = Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")]
RobotArgument = Annotated[str, typer.Argument(help=_ROBOT, metavar="ROBOT")]
RobotOption = Annotated[str, typer.Option(help=_ROBOT, metavar="ROBOT")]
Engine = Annotated[
    str | None,
    typer.Option(
        help="pybullet, mujoco or dart; default: pybullet if it is installed, else mujoco"
    ),
]
FileFormat = Annotated[str, typer.Option("--format", help="csv, parquet or npz")]

# a trajectory within limits
Trajectory = Annotated[Path, typer.Option(help=_TRAJECTORY, metavar="FILE")]
Rate = Annotated[float, typer.Option(help="samples per second that are written [Hz]")]
Velocity = Annotated[float, typer.Option(help="no joint moves faster [rad/s]")]
Acceleration = Annotated[float, typer.Option(help="limit of every joint [rad/s^2]")]
Torque = Annotated[
    float, typer.Option(help="share of the torque limits that may be used [1]")
]
Margin = Annotated[float, typer.Option(help="distance from the position limits [rad]")]
Singular = Annotated[
    float,
    typer.Option(help="least singular value of the Jacobian [m/rad, 1]; 0 for any"),
]
Clearance = Annotated[
    float, typer.Option(help="least distance between bodies and to the surface [m]")
]
Surface = Annotated[
    float, typer.Option(help="height of the surface under the arm, base frame [m]")
]
Collisions = Annotated[
    bool,
    typer.Option(
        help="check collisions by the URDF's shapes, or boxes by its inertials"
    ),
]
SearchSeed = Annotated[
    int | None, typer.Option(min=0, help="find the same trajectory again")
]


def split_names(text: str) -> tuple[str, ...]:
    """Names of an option that are separated by commas."""
    parts = (part.strip() for part in text.split(","))
    return tuple(name for name in parts if name)
