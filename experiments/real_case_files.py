"""Pieces of carriers as case folders; coupled motors stay declared, with recordings on the motors' side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from gapscope.arm.case import Case
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording


def write_piece(case: Case, folder: Path) -> None:
    """Write a case; if motors turn several joints, as seen from the motors and with the transmission declared."""
    matrix = case.importing.transmission if case.importing else None
    if matrix is None:
        write_case(case, folder, overwrite=True)
        return
    recordings = tuple(on_motor_side(r, matrix) for r in case.recordings)
    file = write_case(replace(case, recordings=recordings), folder, overwrite=True)
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    content["import"] = {"transmission": {"matrix": matrix.tolist()}}
    with atomic_write(file) as aside:
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
        aside.write_text(text, encoding="utf-8")


def on_motor_side(recording: Recording, matrix: np.ndarray) -> Recording:
    """q_motor = R q_joint and tau_motor = R^-T tau_joint, with R (n, n) of the case format."""
    dq = None if recording.dq is None else recording.dq @ matrix.T
    torque = np.asarray(recording.tau) @ np.linalg.inv(matrix)
    return replace(recording, q=recording.q @ matrix.T, dq=dq, tau=torque)
