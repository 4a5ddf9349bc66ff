"""A learnt residual network on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from gapscope.reports.residual.wording import FORMS


def joint_table(content: Mapping[str, Any]) -> Table:
    """Torque left per joint: by the corrected arm, with the network, with boosted trees."""
    table = Table(title="torque left on recordings set aside, RMS [N m]", box=None)
    for head in ("joint", "corrected arm", "with network", "with trees"):
        table.add_column(head, justify="left" if head == "joint" else "right")
    table.add_column("form")
    for number, joint in enumerate(content["joints"], 1):
        left = joint["rmse"]
        values = [f"{left[key]:.3g}" for key in ("nothing", "network", "trees")]
        table.add_row(f"J{number} {joint['name']}", *values, FORMS[joint["form"]])
    return table
