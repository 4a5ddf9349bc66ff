"""An exciting trajectory as files: CSV, ROS ``JointTrajectory`` and a page of plots, and a slow version to run first.

Trajectories are read back and checked before any file gets its name.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.sampled import Sampled, read_sampled
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.design import SLOW, Excitation, sampled
from gapscope.ident.excitation.excitation_plan import ExcitationPlan
from gapscope.ident.excitation.trajectory_files import (
    POINTS_PER_PERIOD,
    ROS_RATE,
    read_joint_trajectory,
    write_csv,
    write_joint_trajectory,
)
from gapscope.ident.excitation.written_check import check_written
from gapscope.reports.trajectory.page import write_page


def check_csv(path: Path) -> None:
    """Check the ending before any work is done; raises ``InputError``."""
    if path.suffix != ".csv":
        raise InputError(
            f"the ending {path.suffix!r} is not .csv", "end it in .csv", file=path
        )


def write_trajectory(
    found: Excitation, arm: NominalArm, plan: ExcitationPlan, path: Path
) -> list[Path]:
    """Write a trajectory as CSV, as ``.yaml`` for ROS and as ``.html`` with plots; and slow as CSV and ``.yaml``.

    The slow version, ``NAME_slow``, is the same path at ``SLOW`` times the speed. It is to be run first.

    Raises:
        GapscopeError: a file cannot be written, or what it holds breaks a limit; then none is written.
    """
    slow_path = path.with_name(f"{path.stem}_slow.csv")
    page = path.with_suffix(".html")
    full = Sampled(found.motion)
    with ExitStack() as stack:
        paths = _write_checked(stack, full, 1.0, found, arm, plan, path)
        write_page(found, arm, plan, stack.enter_context(atomic_write(page)))
        slow = full.slower(SLOW)
        slow_paths = _write_checked(stack, slow, SLOW, found, arm, plan, slow_path)
    return [*paths, page, *slow_paths]


def _write_checked(
    stack: ExitStack,
    reference: Sampled,
    speed: float,
    found: Excitation,
    arm: NominalArm,
    plan: ExcitationPlan,
    path: Path,
) -> list[Path]:
    """Write a trajectory as CSV and for ROS under temporary names, which the stack makes final, and check both."""
    ros_path = path.with_suffix(".yaml")
    table, message = (stack.enter_context(atomic_write(x)) for x in (path, ros_path))
    # a player of rows needs the slow version at the same rate
    write_csv(sampled(reference, reference.duration, plan.rate), table)
    check_written(read_sampled(table, arm.n_joints), found.checker, path, speed)
    highest = plan.family(arm.n_joints).highest_frequency
    points = speed * max(ROS_RATE, POINTS_PER_PERIOD * highest)
    write_joint_trajectory(reference.motion, arm.joints, message, points)
    check_written(read_joint_trajectory(message), found.checker, ros_path, speed)
    return [path, ros_path]
