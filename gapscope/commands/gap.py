"""The gap alone, as a document and as a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.assessment.replay_gap import attempt
from gapscope.diagnosis.display import nrmse
from gapscope.diagnosis.gap.torque_gap import torque_gap
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.replay import HORIZON, Replay
from gapscope.ident.signals.conditioning import condition, position_cutoff
from gapscope.reports.diagnosis.fleet_section import (
    cells,
    findings,
    heading,
    nominal_note,
    row_label,
    told_apart,
)


def gap_document(case: Case, corrected: CorrectedArm) -> dict[str, Any]:
    """Both gaps per recording and joint: ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad].

    ``replayed`` says how: through the ``controller`` where it and the reference are known, else under the recorded
    ``torque`` over short horizons, or why not; ``replay_rmse`` is null then.

    Raises:
        GapscopeError: no recording carries a torque.
    """
    recordings = [
        (r, role)
        for role, rs in (("fit", case.recordings), ("judge", case.judged))
        for r in rs
    ]
    measured = [(r, role) for r, role in recordings if r.tau is not None]
    if not measured:
        raise GapscopeError(
            f"{case.name}: no recording carries a torque", "; ".join(case.warnings)
        )
    body = RigidBody(case.arm)
    cutoff = position_cutoff(tuple(r for r, _ in measured))
    rows = []
    for recording, role in measured:
        found = torque_gap(corrected, body, condition(recording, cutoff))
        replayed, problem = attempt(case, corrected.effects, recording)
        through = (
            "torque"
            if case.controller is None or recording.q_ref is None
            else "controller"
        )
        rows.append(
            {
                "recording": recording.name,
                "role": role,
                "torque_nrmse": found.nrmse.tolist(),
                "torque_rmse": found.rmse.tolist(),
                "replay_rmse": None if replayed is None else replayed.tolist(),
                "replayed": problem or through,
            }
        )
    return {
        "schema": 1,
        "case": case.name,
        "joints": list(case.arm.joints),
        "recordings": rows,
    }


def gap_tables(document: dict[str, Any], joints: tuple[str, ...]) -> Group:
    """Torque NRMSE and replay gap as tables, one row per recording, and why a recording was not replayed."""
    torque = _table(f"torque NRMSE of {document['case']}", joints)
    replays = _table("replay gap in mrad", joints)
    notes = []
    for row in document["recordings"]:
        torque.add_row(
            row["recording"], *(f"{value:.3f}" for value in row["torque_nrmse"])
        )
        if row["replay_rmse"] is None:
            notes.append(
                Text(f"{row['recording']} was not replayed: {row['replayed']}")
            )
        else:
            replays.add_row(
                row["recording"],
                *(f"{1e3 * value:.3g}" for value in row["replay_rmse"]),
            )
    return Group(torque, *([replays] if replays.row_count else []), *notes)


def _table(title: str, joints: tuple[str, ...]) -> Table:
    """An empty table with a column per joint."""
    table = Table(title=title, title_justify="left")
    table.add_column("recording")
    for number in range(1, len(joints) + 1):
        table.add_column(f"J{number}", justify="right")
    return table


def units_text(content: Mapping[str, Any]) -> Group:
    """The content of ``units.json``: per type of arm the effects with the units that have them, and the confusion."""
    parts: list[Any] = []
    for group in content["groups"]:
        title = f"{group['robot']}, {len(group['units'])} units"
        table = Table(
            title=title,
            title_justify="left",
            caption=heading(group),
            caption_justify="left",
        )
        for name in ("effect", "on", "found"):
            table.add_column(name, overflow="fold")
        for found in findings(group):
            table.add_row(
                Text(found.name), found.place, Text(f"{found.label}: {found.meaning}")
            )
        notes = [*told_apart(group["confusion"]), nominal_note(group)]
        parts += [
            table,
            *(
                [_confusion(group["confusion"])]
                if group["confusion"]["columns"]
                else []
            ),
        ]
        parts += [Text(note) for note in notes if note]
    return Group(*parts)


def _confusion(confusion: Mapping[str, Any]) -> Table:
    """Mean torque NRMSE of each arm on the recordings of each unit; the least of each column in bold."""
    table = Table(
        title="torque NRMSE of an arm (row) on the recordings of a unit (column)",
        title_justify="left",
    )
    table.add_column("")
    for unit in confusion["columns"]:
        table.add_column(Text(unit), justify="right")
    for row, line in cells(confusion):
        table.add_row(
            Text(row_label(row)),
            *(Text(nrmse(c.value), "bold" if c.best else "") for c in line),
        )
    return table


def replay_line(replayed: Replay) -> str:
    """One line on a replay: its gap per joint, and what moved the arm."""
    how = (
        "through the controller"
        if replayed.through_controller
        else f"recorded torque, every {HORIZON:g} s anew"
    )
    gaps = ", ".join(f"J{j} {1e3 * gap:.3g}" for j, gap in enumerate(replayed.rmse, 1))
    return f"replay gap in mrad, {how}: {gaps}"
