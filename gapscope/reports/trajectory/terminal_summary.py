"""An exciting trajectory on the terminal: margins to the limits, and what was found."""

from __future__ import annotations

import numpy as np
from rich.table import Table
from rich.text import Text

from gapscope.ident.excitation.design import SLOW, Excitation
from gapscope.ident.excitation.excitation_plan import ExcitationPlan


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
    if not any(margin.name == "distance" for margin in found.margins):
        lines.append("collisions were not checked")
    return lines


def margin_table(found: Excitation) -> Table:
    """Least margin to each limit of the joints, with the limit."""
    # jerk has a line of its own: its column would not fit
    per_joint = [m for m in found.margins if m.limit.ndim and m.name != "jerk"]
    table = Table(
        title="least margin to each limit, and the limit", title_justify="left"
    )
    table.add_column("joint")
    for margin in per_joint:
        table.add_column(Text(f"{margin.name} [{margin.unit}]"), justify="right")
    for j in range(found.motion.q.shape[1]):
        values = (f"{m.margin[j]:.3g} of {m.limit[j]:.4g}" for m in per_joint)
        table.add_row(f"J{j + 1}", *values)
    return table


def margin_lines(found: Excitation) -> list[str]:
    """Least margin to each limit of the whole arm, and what to run first."""
    lines = []
    for margin in found.margins:
        if margin.name == "jerk":
            used = 1 - float((margin.margin / margin.limit).min())
            lines.append(f"jerk: at most {used:.0%} of its limit, at {margin.at:.2f} s")
        if margin.limit.ndim:
            continue
        unit = "" if margin.unit == "1" else f" {margin.unit}"
        least = float(margin.limit + margin.margin)
        lines.append(
            f"{margin.name}: at least {least:.4g}{unit} (limit {float(margin.limit):.4g}), "
            f"least at {margin.at:.2f} s"
        )
    lines.append(
        f"run the files that end in _slow first: the same path at {SLOW:g} times the speed"
    )
    return lines
