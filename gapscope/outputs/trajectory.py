"""An exciting trajectory as files: CSV, ROS ``JointTrajectory`` and a page of plots."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.design import Excitation
from gapscope.ident.excitation.excitation_plan import ExcitationPlan
from gapscope.ident.excitation.trajectory_files import write_csv, write_joint_trajectory
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
    """Write a trajectory as CSV, and beside it as ``.yaml`` for ROS and as ``.html`` with plots.

    Raises:
        GapscopeError: a file cannot be written.
    """
    trajectory, page = path.with_suffix(".yaml"), path.with_suffix(".html")
    write_csv(found.motion, path)
    write_joint_trajectory(found.motion, arm.joints, trajectory)
    write_page(found, arm, plan, page)
    return [path, trajectory, page]
