"""The gap of a case as data, for JSON and for tables."""

from __future__ import annotations

from typing import Any

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.assessment.replay_gap import attempt
from gapscope.diagnosis.gap.plausible_data import check_rates
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition
from gapscope.model.torque_gap import torque_gap


def gap_document(case: Case, corrected: CorrectedArm) -> dict[str, Any]:
    """Both gaps per recording and joint: ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad].

    ``replayed`` says how: through the ``controller`` if it and the reference are known, else under the recorded
    ``torque`` over short horizons, or why not; ``replay_rmse`` is null then. ``warnings`` are what was noticed while
    the recordings were read.

    Raises:
        GapscopeError: no recording carries a torque.
        InputError: the stamps of one give a rate at which no robot is logged.
    """
    check_rates(case)
    roles = [(recording, "fit") for recording in case.recordings]
    roles += [(recording, "judge") for recording in case.judged]
    measured = [
        (recording, role) for recording, role in roles if recording.tau is not None
    ]
    if not measured:
        raise GapscopeError(
            f"{case.name}: no recording carries a torque", "; ".join(case.warnings)
        )
    body = RigidBody(case.arm)
    rows = [
        {"recording": recording.name, "role": role}
        | _torque(recording, corrected, body)
        | _replay(recording, case, corrected)
        for recording, role in measured
    ]
    return {
        "schema": 1,
        "case": case.name,
        "joints": list(case.arm.joints),
        "sliding": [j for j, slides in enumerate(case.arm.sliding, 1) if slides],
        "recordings": rows,
        "warnings": [
            *(f"{r.name}: {note}" for r, _ in roles for note in r.notes),
            *filter(None, (corrected.taken_as(r.name) for r, _ in measured)),
        ],
    }


def _torque(
    recording: Recording, corrected: CorrectedArm, body: RigidBody
) -> dict[str, Any]:
    found = torque_gap(corrected, body, condition(recording))
    return {"torque_nrmse": found.nrmse.tolist(), "torque_rmse": found.rmse.tolist()}


def _replay(
    recording: Recording, case: Case, corrected: CorrectedArm
) -> dict[str, Any]:
    replayed, problem, _ = attempt(
        case,
        corrected.effects,
        recording,
        residual=corrected.residual,
        states=corrected.states,
    )
    through_controller = case.controller is not None and recording.q_ref is not None
    how = "controller" if through_controller else "torque"
    return {
        "replay_rmse": None if replayed is None else replayed.tolist(),
        "replayed": problem or how,
    }
