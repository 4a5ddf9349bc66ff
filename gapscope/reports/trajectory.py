"""A designed motion as a page, on the terminal and as files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.text import Text

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.joint_units import common_unit
from gapscope.arm.motions.trajectory import Sampled, read_sampled
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.document.wording import Document
from gapscope.ident.excitation.design import (
    POINTS_PER_PERIOD,
    ROS_RATE,
    SLOW,
    Excitation,
    ExcitationPlan,
    check_written,
    read_joint_trajectory,
    sampled,
    write_csv,
    write_joint_trajectory,
)
from gapscope.reports.expected import expected_table
from gapscope.reports.pages import (
    PageSection,
    Panel,
    figure_html,
    panels_figure,
    write_plot_page,
)

# A designed motion as a page and on the terminal.


# A trajectory as a page of plots that opens without a network.


POINTS = 2000
"""Most points of a curve."""


def write_page(
    found: Excitation, arm: NominalArm, plan: ExcitationPlan, path: Path
) -> None:
    """Write position, velocity, acceleration and torque of all joints over time, and the margins to the limits.

    Raises:
        GapscopeError: the file cannot be written.
    """
    facts = (
        f"{plan.kind}, {plan.length:g} s, criterion {plan.criterion}: condition number {found.condition:.3g} of "
        f"{len(found.names)} base columns scaled to unit norm, {found.inertial_condition:.3g} of the inertial ones "
        "alone. Run the files that end in _slow first: the same path at a fraction of the speed."
    )
    # one panel per quantity, one above the other, over the same time
    motion = found.motion
    step = -(-len(motion.t) // POINTS)  # rounded up
    panels = [
        Panel(f"{name} [{common_unit(unit, arm.sliding)}]", motion.t[::step], x[::step])
        for name, unit, x in (
            ("position", "rad", motion.q),
            ("velocity", "rad/s", motion.dq),
            ("acceleration", "rad/s²", motion.ddq),
            ("torque", "N m", found.torque),
        )
    ]
    joints = [f"J{j}" for j in range(1, arm.n_joints + 1)]
    figure = figure_html(
        panels_figure(panels, joints, shared_xaxes=True, vertical_spacing=0.03),
        "trajectory",
        920,
        hovermode="x unified",
        margin={"l": 62, "r": 14, "t": 34, "b": 46},
        legend_at=1,
    )
    margins = replace(_of_joints(found, arm.joints), note=". ".join(_of_arm(found)))
    title = f"Exciting trajectory of {arm.name}"
    write_plot_page(path, title, facts, [PageSection(figure=figure), margins])


def _of_joints(
    found: Excitation, joints: Sequence[str], left_out: str = ""
) -> PageSection:
    """The least margin of each joint to each limit over all samples, and the limit."""
    margins = [m for m in found.margins if m.limit.ndim and m.name != left_out]
    rows = [
        [name, *(f"{m.margin[j]:.3g} of {m.limit[j]:.4g}" for m in margins)]
        for j, name in enumerate(joints)
    ]
    heads = ("joint", *(f"{m.name} [{m.unit}]" for m in margins))
    title = "Least margin to each limit, and the limit"
    return PageSection(title, heads, rows, numbers=True)


def _of_arm(found: Excitation) -> Iterator[str]:
    """What is nearest to each limit that the whole arm has."""
    for margin in found.margins:
        if not margin.limit.ndim:
            unit = "" if margin.unit == "1" else f" {margin.unit}"
            least = float(margin.limit + margin.margin)
            yield (
                f"{margin.name}: at least {least:.4g}{unit} (limit {float(margin.limit):.4g}), "
                f"least at {margin.at:.2f} s"
            )


# An exciting trajectory on the terminal: margins to the limits, and what was found.


def summary(found: Excitation, plan: ExcitationPlan) -> list[str]:
    """What was found, in a few lines."""
    lines = [
        f"condition number {found.condition:.3g}, {len(found.names)} base columns scaled to unit norm; "
        f"{found.inertial_condition:.3g} for the inertial ones alone",
        f"{plan.method}: {found.evaluations} evaluations, {found.feasible} candidates within all limits, "
        f"{found.seconds:.1f} s",
    ]
    if found.separated is not None:
        angles = [
            f"{a} and {b} {np.rad2deg(angle):.0f}°"
            for (a, b), angle in found.separated.angle.items()
        ]
        lines.append(
            f"separation {found.separated.least:.3f} (1 at best); least angle between {', '.join(angles)}"
        )
    if found.left_out:
        pairs = ", ".join(f"{a} / {b}" for a, b in found.left_out)
        lines.append(f"not checked, as they touch by construction: {pairs}")
    # a missing margin means that nothing was looked at
    if not any(margin.name == "distance" for margin in found.margins):
        lines.append("collisions were not checked")
    return lines


def shown(
    found: Excitation, expected: Sequence[Document], lines: Sequence[str]
) -> Group:
    """What a terminal shows: least margins to the limits, sizes at which effects would be named, and some lines."""
    joints = [f"J{j + 1}" for j in range(found.motion.q.shape[1])]
    # jerk has a line of its own: its column would not fit
    table = _of_joints(found, joints, "jerk").on_terminal()
    texts = [
        f"jerk: at most {1 - (margin.margin / margin.limit).min():.0%} of its limit, at {margin.at:.2f} s"
        for margin in found.margins
        if margin.name == "jerk"
    ]
    texts += _of_arm(found)
    texts.append(
        f"run the files that end in _slow first: the same path at {SLOW:g} times the speed"
    )
    sizes = expected_table(expected, len(joints))
    return Group(table, sizes, *map(Text, (*texts, *lines)))


# An exciting trajectory as files: CSV, ROS ``JointTrajectory`` and a page of plots, and a slow version to run first.
#
# Trajectories are read back and checked before any file gets its name.


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
    highest = plan.family(arm.n_joints).highest_frequency
    # all files get their names together, once all of them are checked
    with ExitStack() as stack:

        def checked(reference: Sampled, speed: float, path: Path) -> list[Path]:
            """Write as CSV and for ROS under temporary names, which the stack makes final, and check both."""
            both = [path, path.with_suffix(".yaml")]
            table, message = (stack.enter_context(atomic_write(x)) for x in both)
            # a player of rows needs the slow version at the same rate
            write_csv(sampled(reference, reference.duration, plan.rate), table)
            check_written(read_sampled(table, arm.n_joints), found.checker, path, speed)
            points = speed * max(ROS_RATE, POINTS_PER_PERIOD * highest)
            write_joint_trajectory(reference.motion, arm.joints, message, points)
            written = read_joint_trajectory(message)
            check_written(written, found.checker, both[1], speed)
            return both

        paths = checked(full, 1.0, path)
        write_page(found, arm, plan, stack.enter_context(atomic_write(page)))
        slow = checked(full.slower(SLOW), SLOW, slow_path)
    return [*paths, page, *slow]
