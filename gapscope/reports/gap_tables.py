"""The gap as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.envs.replay import HORIZON, Replay


def gap_tables(document: dict[str, Any]) -> Group:
    """Torque NRMSE and replay gap as tables, one row per recording, and why a recording was not replayed."""
    count = len(document["joints"])
    torque = _table(f"torque NRMSE of {document['case']}", count)
    replays = _table(f"replay gap in {_unit(document['sliding'])}", count)
    notes = []
    for row in document["recordings"]:
        name = row["recording"]
        torque.add_row(name, *(f"{value:.3f}" for value in row["torque_nrmse"]))
        if row["replay_rmse"] is None:
            notes.append(Text(f"{name} was not replayed: {row['replayed']}"))
        else:
            angles = (f"{1e3 * value:.3g}" for value in row["replay_rmse"])
            replays.add_row(name, *angles)
    tables = [torque, replays] if replays.row_count else [torque]
    return Group(*tables, *notes)


def _unit(sliding: Sequence[object]) -> str:
    """Unit of a thousandth of what positions count in, if some joints slide."""
    return "mrad, of sliding joints in mm" if sliding else "mrad"


def _table(title: str, joints: int) -> Table:
    """An empty table with a column per joint."""
    table = Table(title=title, title_justify="left")
    table.add_column("recording")
    for number in range(1, joints + 1):
        table.add_column(f"J{number}", justify="right")
    return table


def replay_line(replayed: Replay) -> str:
    """One line on a replay: its gap per joint, and what moved the arm."""
    how = (
        "through the controller"
        if replayed.through_controller
        else f"recorded torque, every {HORIZON:g} s anew"
    )
    gaps = ", ".join(f"J{j} {1e3 * gap:.3g}" for j, gap in enumerate(replayed.rmse, 1))
    return f"replay gap in {_unit([s for s in replayed.sliding if s])}, {how}: {gaps}"
