"""An exciting trajectory for an arm: files in, files out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.commands.diagnose import make_folder
from gapscope.ident.excitation.design import Excitation, design
from gapscope.ident.excitation.excitation_plan import ExcitationPlan, LimitPlan
from gapscope.ident.excitation.trajectory_files import write_csv, write_joint_trajectory
from gapscope.reports.trajectory.page import write_picture


def excite_files(
    robot: str,
    out: Path,
    plan: ExcitationPlan,
    limits: LimitPlan,
    *,
    seed: int | None = None,
    progress: Callable[[float, float], None] = lambda share, best: None,
) -> tuple[Excitation, list[Path]]:
    """Find an exciting trajectory and write it.

    Args:
        robot: a name or URDF; or a case, whose nominal arm is taken.
        out: CSV to write; the ``JointTrajectory`` (``.yaml``) and the plot (``.html``) are put beside it.
        plan: what to look for.
        limits: what to keep.
        seed: of the search; by default another one each time.
        progress: called with the share of the budget spent and the best value so far, or infinity.

    Returns:
        What was found, and the files.

    Raises:
        InputError: an argument is at fault, or the limits allow no trajectory.
        GapscopeError: a file cannot be written.
    """
    if out.suffix != ".csv":
        raise InputError(
            f"the ending {out.suffix!r} is not .csv", "end it in .csv", file=out
        )
    arm = _arm(robot)
    make_folder(out.resolve().parent)
    found = design(arm, plan, limits, np.random.default_rng(seed), progress)
    paths = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    write_csv(found.motion, paths[0])
    write_joint_trajectory(found.motion, arm.joints, paths[1])
    write_picture(found, arm, plan, paths[2])
    return found, paths


def _arm(robot: str) -> NominalArm:
    path = Path(robot)
    if path.suffix in (".yaml", ".yml") or path.is_dir():
        return load_case(path, read_recordings=False).arm
    return load_nominal_arm(robot)


class SearchProgress:
    """How far a search is, and the best value so far: a bar on a terminal, a few lines elsewhere."""

    def __init__(self, label: str, criterion: str, console: Console) -> None:
        self._label, self._criterion, self._console = label, criterion, console
        columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
        self._bar = (
            Progress(*columns, console=console, transient=True)
            if console.is_terminal
            else None
        )
        self._task = self._bar.add_task(label, total=1.0) if self._bar else None
        self._told = -1

    def __enter__(self) -> SearchProgress:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def __call__(self, share: float, best: float) -> None:
        """Show the share of the budget spent [1] and the best value of the criterion, or infinity."""
        if self._bar and self._task is not None:
            self._bar.update(
                self._task,
                completed=share,
                description=f"{self._label}: {self._text(best)}",
            )
        elif int(4 * share) > self._told:
            self._told = int(4 * share)
            self._console.print(
                f"{self._label}: {share:.0%}, {self._text(best)}",
                highlight=False,
                markup=False,
            )

    def _text(self, best: float) -> str:
        if not np.isfinite(best):
            return "none within the limits yet"
        if self._criterion in ("condition", "separation"):
            return f"{self._criterion} {np.exp(best if self._criterion == 'condition' else -best):.3g}"
        return f"{self._criterion}-criterion {best:.3f}"


def summary(found: Excitation, plan: ExcitationPlan) -> list[str]:
    """What was found, in a few lines."""
    lines = [
        f"condition number {found.condition:.3g}, {len(found.names)} base columns scaled to unit norm; "
        f"{found.inertial_condition:.3g} for the inertial ones alone",
        f"{plan.method}: {found.evaluations} evaluations, {found.feasible} candidates within all limits, "
        f"{found.seconds:.1f} s",
    ]
    if found.separated is not None:
        apart = ", ".join(
            f"{a} and {b} {np.rad2deg(angle):.0f}°"
            for (a, b), angle in found.separated.angle.items()
        )
        lines.append(
            f"separation {found.separated.least:.3f} (1 at best); least angle between {apart}"
        )
    if found.left_out:
        lines.append(
            "not checked, as they touch by construction: "
            + ", ".join(f"{a} / {b}" for a, b in found.left_out)
        )
    if not any(margin.name == "distance" for margin in found.margins):
        lines.append("collisions were not checked")
    return lines


def margin_table(found: Excitation) -> Table:
    """Least margin to each limit of the joints, with the limit."""
    per_joint = [margin for margin in found.margins if margin.limit.ndim]
    table = Table(
        title="least margin to each limit, and the limit", title_justify="left"
    )
    table.add_column("joint")
    for margin in per_joint:
        table.add_column(Text(f"{margin.name} [{margin.unit}]"), justify="right")
    for j in range(found.motion.q.shape[1]):
        table.add_row(
            f"J{j + 1}", *(f"{m.margin[j]:.3g} of {m.limit[j]:.4g}" for m in per_joint)
        )
    return table


def margin_lines(found: Excitation) -> list[str]:
    """Least margin to each limit of the whole arm."""
    whole = [margin for margin in found.margins if not margin.limit.ndim]
    return [
        f"{m.name}: at least {float(m.limit + m.margin):.4g} {m.unit if m.unit != '1' else ''}".rstrip()
        + f" (limit {float(m.limit):.4g}), least at {m.at:.2f} s"
        for m in whole
    ]
