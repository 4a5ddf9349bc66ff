"""The command ``gapscope excite``: an exciting trajectory within limits."""

from __future__ import annotations

from gapscope.commands.options import (
    Limits,
    Rate,
    RobotArgument,
    SearchSeed,
    Trajectory,
    split_names,
)
from gapscope.terminal import console, log, say, wrote


def excite(
    robot: RobotArgument,
    *,
    out: Trajectory,
    kind: str = "fourier",
    order: int = 5,
    frequency: float = 0.1,
    duration: float | None = None,
    rate: Rate = 250.0,
    criterion: str = "condition",
    effects: str = "",
    optimiser: str | None = None,
    evaluations: int = 3000,
    seconds: float | None = None,
    limits: Limits,
    seed: SearchSeed = None,
) -> None:
    """Design an exciting trajectory within limits.

    It is written as CSV, as a ROS JointTrajectory, and as a page of plots.

    Args:
        kind: fourier, quintic (through way points) or multisine
        order: number of harmonics; half that of way points
        frequency: of the first harmonic [Hz]
        duration: length [s]; by default 10, or one period
        criterion: condition, d, e or separation (of --effects)
        effects: effects to tell apart, with commas between them
        optimiser: random, swarm, cma or gradient
        evaluations: objective evaluations; a gradient counts as 8
        seconds: time to search, at most [s]
    """
    from gapscope.commands.search_progress import SearchProgress
    from gapscope.ident.excitation.design import ExcitationPlan
    from gapscope.ident.excitation.trajectory_search import Budget
    from gapscope.interface.advise import excite as excite_arm
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
    with SearchProgress(robot, criterion, log) as progress:
        check_csv(out)
        result = excite_arm(robot, plan, limits, seed=seed, progress=progress)
        paths = result.write(out)
    found = result.excitation
    console.print(margin_table(found))
    console.print(expected_table(result.expected(), result.arm.n_joints))
    say(*margin_lines(found), *summary(found, plan))
    wrote(*paths)
