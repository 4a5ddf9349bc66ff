"""The gap alone, as a document and as a table."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from arm.case import Case
from arm.dynamics import RigidBody
from arm.errors import GapscopeError
from diagnosis.gap import torque_gap
from effects.corrected import CorrectedArm
from ident.conditioning import condition, position_cutoff


def gap_document(case: Case, corrected: CorrectedArm) -> dict[str, Any]:
    """Torque gap per recording and joint: ``torque_nrmse`` [1] and ``torque_rmse`` [N m]; ``replay_rmse`` is null.

    Raises:
        GapscopeError: no recording carries a torque.
    """
    recordings = [(r, role) for role, rs in (("fit", case.recordings), ("judge", case.judged)) for r in rs]
    measured = [(r, role) for r, role in recordings if r.tau is not None]
    if not measured:
        raise GapscopeError(f"{case.name}: no recording carries a torque", "; ".join(case.warnings))
    body = RigidBody(case.arm)
    cutoff = position_cutoff(tuple(r for r, _ in measured))
    rows = []
    for recording, role in measured:
        found = torque_gap(corrected, body, condition(recording, cutoff))
        rows.append(
            {
                "recording": recording.name,
                "role": role,
                "torque_nrmse": found.nrmse.tolist(),
                "torque_rmse": found.rmse.tolist(),
                "replay_rmse": None,
            }
        )
    return {"schema": 1, "case": case.name, "joints": list(case.arm.joints), "recordings": rows}


def gap_table(document: dict[str, Any], joints: tuple[str, ...]) -> Table:
    """The torque NRMSE as a table, one row per recording."""
    table = Table(title=f"torque NRMSE of {document['case']}", title_justify="left")
    table.add_column("recording")
    for number in range(1, len(joints) + 1):
        table.add_column(f"J{number}", justify="right")
    for row in document["recordings"]:
        table.add_row(row["recording"], *(f"{value:.3f}" for value in row["torque_nrmse"]))
    return table
