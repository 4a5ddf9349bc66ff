"""The gap of a case as tables and files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.text import Text

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.assessment.replay_gap import attempt
from gapscope.diagnosis.document.wording import Document
from gapscope.diagnosis.gap.plausible_data import check_rates, no_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.replay import HORIZON, Replay
from gapscope.model.conditioning import condition
from gapscope.model.torque_gap import torque_gap
from gapscope.reports.pages import terminal_table

# The gap as tables on the terminal.


def gap_tables(document: Document) -> Group:
    """Torque NRMSE and replay gap as tables, one row per recording, and why a recording was not replayed."""
    count = len(document["joints"])
    heads = ["recording", *(f"J{j}" for j in range(1, count + 1))]
    torques, replays, notes = [], [], []
    for row in document["recordings"]:
        name = row["recording"]
        torques.append([name, *(f"{value:.3f}" for value in row["torque_nrmse"])])
        if row["replay_rmse"] is None:
            notes.append(Text(f"{name} was not replayed: {row['replayed']}"))
        else:
            # positions count in rad or m: thousandths of both
            angles = (f"{1e3 * value:.3g}" for value in row["replay_rmse"])
            replays.append([name, *angles])
    title = f"torque NRMSE of {document['case']}"
    tables = [terminal_table(heads, torques, title=title)]
    if replays:
        title = f"replay gap in {_unit(document['sliding'])}"
        tables.append(terminal_table(heads, replays, title=title))
    return Group(*tables, *notes)


def _unit(sliding: Sequence[object]) -> str:
    """Unit of a thousandth of what positions count in, if some joints slide."""
    return "mrad, of sliding joints in mm" if sliding else "mrad"


def replay_line(replayed: Replay) -> str:
    """One line on a replay: its gap per joint, and what moved the arm."""
    how = (
        "through the controller"
        if replayed.through_controller
        else f"recorded torque, every {HORIZON:g} s anew"
    )
    gaps = ", ".join(f"J{j} {1e3 * gap:.3g}" for j, gap in enumerate(replayed.rmse, 1))
    return f"replay gap in {_unit([s for s in replayed.sliding if s])}, {how}: {gaps}"


# The gap of a case as data, for JSON and for tables.


def gap_document(case: Case, corrected: CorrectedArm) -> dict[str, Any]:
    """Both gaps per recording and joint: ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad].

    ``replayed`` says how: through the ``controller`` if it and the reference are known, else under the recorded
    ``torque`` over short horizons, or why not; ``replay_rmse`` is null then. ``warnings`` are what was noticed while
    the recordings were read.

    Raises:
        GapscopeError: no recording carries a torque.
        InputError: the stamps of one give a rate at which no robot is logged.
    """
    # nothing is repaired here: stamps have to be in order
    check_rates(case)
    measured = [
        (recording, role)
        for role, group in (("fit", case.recordings), ("judge", case.judged))
        for recording in group
        if recording.tau is not None
    ]
    if not measured:
        raise no_torque(case)
    body = RigidBody(case.arm)
    rows = []
    for recording, role in measured:
        found = torque_gap(corrected, body, condition(recording))
        tried = attempt(
            case,
            corrected.effects,
            recording,
            residual=corrected.residual,
            states=corrected.states,
        )
        rows.append(
            {
                "recording": recording.name,
                "role": role,
                "torque_nrmse": found.nrmse.tolist(),
                "torque_rmse": found.rmse.tolist(),
                "replay_rmse": None if tried.rmse is None else tried.rmse.tolist(),
                "replayed": tried.why
                or ("controller" if tried.through_controller else "torque"),
            }
        )
    return {
        "schema": 1,
        "case": case.name,
        "joints": list(case.arm.joints),
        "sliding": [j for j, slides in enumerate(case.arm.sliding, 1) if slides],
        "recordings": rows,
        "warnings": [
            *case.notes,
            *filter(None, (corrected.taken_as(r.name) for r, _ in measured)),
        ],
    }
