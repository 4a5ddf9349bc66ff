"""The commands about an arm's own parameters: identify and excite."""

from __future__ import annotations

from typing import Annotated, Optional

import typer

from gapscope.commands.options import (
    Acceleration,
    CasePath,
    Clearance,
    Collisions,
    Margin,
    Rate,
    Results,
    RobotArgument,
    SearchSeed,
    Singular,
    Surface,
    Torque,
    Trajectory,
    Velocity,
)
from gapscope.terminal import Progress, console, log, wrote


def identify(
    case: CasePath,
    out: Results,
    cutoff: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            min=0.1,
            help="cut-off of both sides [Hz]; default: from the spectra of the positions",
        ),
    ] = None,
    estimator: Annotated[
        str,
        typer.Option(
            help="consistent, wls, ols, irls, ridge, truncated_svd, total_least_squares, maximum_likelihood, "
            "partial_update, log_cholesky, sdp_euclidean or sdp_entropic"
        ),
    ] = "consistent",
    judge: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            help="name of a recording to judge on; default: the case's, or the last",
            metavar="NAME",
        ),
    ] = None,
    any_torque: Annotated[
        bool,
        typer.Option(
            "--any-torque", help="go on where the torque seems not to be in N m"
        ),
    ] = False,
) -> None:
    """Identify base and physical parameters and friction."""
    from gapscope.commands.identify import identify_path, summary
    from gapscope.ident.identification import IdentificationSettings

    settings = IdentificationSettings(cutoff, estimator, tuple(judge or ()), any_torque)
    with Progress(case.name or str(case)) as progress:
        identified = identify_path(case, out, settings, progress)
    console.print(summary(identified))
    wrote(*identified.paths)


def excite(
    robot: RobotArgument,
    out: Trajectory,
    kind: Annotated[
        str, typer.Option(help="fourier, quintic (through way points) or multisine")
    ] = "fourier",
    order: Annotated[
        int, typer.Option(help="number of harmonics; half that of way points")
    ] = 5,
    frequency: Annotated[float, typer.Option(help="of the first harmonic [Hz]")] = 0.1,
    duration: Annotated[
        float | None, typer.Option(help="length [s]; by default 10, or one period")
    ] = None,
    rate: Rate = 250.0,
    criterion: Annotated[
        str, typer.Option(help="condition, d, e or separation (of --effects)")
    ] = "condition",
    effects: Annotated[
        str, typer.Option(help="effects to tell apart, with commas between them")
    ] = "",
    optimiser: Annotated[
        str | None, typer.Option(help="random, swarm, cma or gradient")
    ] = None,
    evaluations: Annotated[
        int, typer.Option(help="candidates to judge; 8 for one with its gradient")
    ] = 3000,
    seconds: Annotated[
        float | None, typer.Option(help="time to search, at most [s]")
    ] = None,
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
    from gapscope.commands.excite import (
        SearchProgress,
        excite_files,
        margin_lines,
        margin_table,
        summary,
    )
    from gapscope.ident.excitation.excitation_plan import ExcitationPlan, LimitPlan
    from gapscope.ident.excitation.trajectory_search import Budget

    names = tuple(name.strip() for name in effects.split(",") if name.strip())
    plan = ExcitationPlan(
        kind,
        order,
        frequency,
        duration,
        rate,
        criterion,
        names,
        optimiser=optimiser,
        budget=Budget(evaluations, seconds),
    )
    limits = LimitPlan(
        velocity, acceleration, torque, margin, singular, clearance, surface, collisions
    )
    with SearchProgress(robot, criterion, log) as progress:
        found, paths = excite_files(
            robot, out, plan, limits, seed=seed, progress=progress
        )
    console.print(margin_table(found))
    for line in (*margin_lines(found), *summary(found, plan)):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrote(*paths)
