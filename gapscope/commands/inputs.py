"""What several commands read: an arm, a model of it, a recording."""

from __future__ import annotations

import os
from pathlib import Path

from gapscope.arm.case import Case, case_files, load_case
from gapscope.arm.controller import Controller
from gapscope.arm.input_file import is_folder
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.table import DAMAGED, PAUSE
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.interface.models import check_recording
from gapscope.terminal import note


def is_case(path: Path) -> bool:
    """Whether a path names a case: a folder, or a YAML file."""
    return is_folder(path) or path.suffix in (".yaml", ".yml")


def read_arm(robot: str) -> NominalArm:
    """The nominal arm of a name, a URDF or a case.

    Raises:
        InputError: it cannot be used.
    """
    return read_arm_and_controller(robot)[0]


def read_arm_and_controller(robot: str) -> tuple[NominalArm, Controller | None]:
    """The nominal arm of a name, a URDF or a case, with the controller that a case has.

    Raises:
        InputError: it cannot be used.
    """
    path = Path(robot)
    if not is_case(path):
        return load_nominal_arm(robot), None
    case = load_case(path, read_recordings=False)
    return case.arm, case.controller


def read_recording(
    case_path: Path, file: Path, *, every_row: bool = False
) -> tuple[Case, Recording]:
    """A case, and a recording in its form, with the payload that the case names for it.

    Args:
        case_path: the case.
        file: the recording, relative to the current folder; or its name in the case.
        every_row: keep every row that can be read; the recording then may hold no more than t and q.

    Raises:
        InputError: the case or the recording cannot be used.
    """
    case = load_case(case_path, read_recordings=False)
    if not os.path.lexists(file):
        # behind the case file and the robot's
        own = {path.name: path for path in case_files(case_path)[2:]}
        if str(file) not in own:
            check_recording(file, own)
        file = own[str(file)]
    recording = load_recording(
        file,
        case.arm,
        case.importing,
        every_row=every_row,
        payload=case.payload_of(file),
    )
    for said in recording.notes:
        if said.startswith((DAMAGED, PAUSE)):
            note(f"{file}: {said}")
    return case, recording
