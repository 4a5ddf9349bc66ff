"""The command ``gapscope excite``: an exciting trajectory within limits."""

from __future__ import annotations

from typing import Annotated

import typer

from gapscope.commands.options import (
    Acceleration,
    Clearance,
    Collisions,
    Margin,
    Rate,
    RobotArgument,
    SearchSeed,
    Singular,
    Surface,
    Torque,
    Trajectory,
    Velocity,
    split_names,
)
from gapscope.terminal import console, log, say, wrote

Kind = Annotated[
    str, typer.Option(help="fourier, quintic (through way points) or multisine")
]
Order = Annotated[
    int, typer.Option(help="number of harmonics; half that of way points")
]
Frequency = Annotated[float, typer.Option(help="of the first harmonic [Hz]")]
Duration = Annotated[
    float | None, typer.Option(help="length [s]; by default 10, or one period")
]
Criterion = Annotated[
    str, typer.Option(help="condition, d, e or separation (of --effects)")
]
Effects = Annotated[
    str, typer.Option(help="effects to tell apart, with commas between them")
]
Optimiser = Annotated[str | None, typer.Option(help="random, swarm, cma or gradient")]
Evaluations = Annotated[
    int, typer.Option(help="objective evaluations; a gradient counts as 8")
]
Seconds = Annotated[float | None, typer.Option(help="time to search, at most [s]")]


def excite(
    robot: RobotArgument,
    out: Trajectory,
    kind: Kind = "fourier",
    order: Order = 5,
    frequency: Frequency = 0.1,
    duration: Duration = None,
    rate: Rate = 250.0,
    criterion: Criterion = "condition",
    effects: Effects = "",
    optimiser: Optimiser = None,
    evaluations: Evaluations = 3000,
    seconds: Seconds = None,
    velocity: Velocity = 1.5,
    acceleration: Acceleration = 5.0,
    torque: Torque = 0.8,
    margin: Margin = 0.1,
    singular: Singular = 0.02,
    clearance: Clearance = 0.01,
    surface: Surface = 0.0,
    collisions: Collisions = True,
    seed: SearchSeed = None,
) -> None:
    """Design an exciting trajectory within limits.

    It is written as CSV, as a ROS JointTrajectory, and as a page of plots.
    """
    from gapscope.commands.search_progress import SearchProgress
    from gapscope.ident.excitation.design import ExcitationPlan, LimitPlan
    from gapscope.ident.excitation.trajectory_search import Budget
    from gapscope.interface.excite import excite as excite_arm
    from gapscope.reports.expected import expected_table
    from gapscope.reports.trajectory import (
        check_csv,
        margin_lines,
        margin_table,
        summary,
    )

    plan = ExcitationPlan(
        kind,
        order,
        frequency,
        duration,
        rate,
        criterion,
        split_names(effects),
        optimiser=optimiser,
        budget=Budget(evaluations, seconds),
    )
    limits = LimitPlan(
        velocity, acceleration, torque, margin, singular, clearance, surface, collisions
    )
    with SearchProgress(robot, criterion, log) as progress:
        check_csv(out)
        result = excite_arm(robot, plan, limits, seed=seed, progress=progress)
        paths = result.write(out)
    found = result.excitation
    console.print(margin_table(found))
    console.print(expected_table(result.expected(), result.arm.n_joints))
    say(*margin_lines(found), *summary(found, plan))
    wrote(*paths)
