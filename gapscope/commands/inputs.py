"""What several commands read and check before they work: an arm, a recording, places, a controller."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.case import Case, load_case
from gapscope.arm.control import LAWS
from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import is_case, read_controller
from gapscope.arm.io.table import DAMAGED, PAUSE
from gapscope.arm.io.write_case import is_used
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.interface.models import recording_of
from gapscope.terminal import note


def read_arm_and_controller(robot: str) -> tuple[NominalArm, Controller | None]:
    """The nominal arm of a name, a URDF or a case, with the controller that a case has.

    Raises:
        InputError: it cannot be used.
    """
    path = Path(robot)
    if not is_case(path):
        # a name or a URDF: only a case knows its controller
        return load_nominal_arm(robot), None
    case = load_case(path, read_recordings=False)
    return case.arm, case.controller


def read_recording(
    case_path: Path, file: Path, *, every_row: bool = False
) -> tuple[Case, Recording]:
    """A case, and a recording of it or in its form; see ``recording_of``. Says what rows are missing.

    Args:
        case_path: the case.
        file: the recording.
        every_row: keep every row that can be read; the recording then may hold no more than t and q.

    Raises:
        InputError: the case or the recording cannot be used.
    """
    case = load_case(case_path, read_recordings=False)
    recording = recording_of(case, file, every_row=every_row)
    # other notes are said with a diagnosis; these are about rows that are missing
    for said in recording.notes:
        if said.startswith((DAMAGED, PAUSE)):
            note(f"{file}: {said}")
    return case, recording


ENDINGS = ["csv", "parquet", "npz"]
"""Formats of the recordings."""
TRUTH = "truth.yaml"
"""File with the effects of a recorded case."""


def check_places(effects: Path, out: Path, sealed: Path | None) -> None:
    """Check, before any work, that the case can be made there and that a sealed truth stays out of it."""
    if is_used(out):
        raise InputError("exists already", "choose a new folder with --out", file=out)
    if sealed is None:
        return
    inside, folder = out.resolve(), sealed.resolve()
    if folder == inside or inside in folder.parents:
        raise InputError(
            "lies in the case's folder, so the truth would not be sealed",
            "choose another",
            file=sealed,
        )
    # recorded again from its own truth nothing is lost
    if (sealed / TRUTH).exists() and (sealed / TRUTH).resolve() != effects.resolve():
        raise InputError(
            "exists already and would be lost",
            "choose another folder",
            file=sealed / TRUTH,
        )


def chosen_controller(
    controller: str | None, arm: NominalArm, known: Controller | None
) -> Controller | str:
    """The controller of a file, or the one known of a case; a control law for gains that fit the arm."""
    if controller is None:
        # a case's own, else the first law, with gains that fit the arm
        return known or next(iter(LAWS))
    path = Path(controller)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return read_controller(path, arm.n_joints)
    if controller not in LAWS:
        raise InputError(
            f"unknown controller {controller!r}",
            f"{nearest(controller, LAWS)}give {', '.join(LAWS)}, or the path of a YAML file in the form "
            "of the controller: section of a case",
            where="controller",
        )
    # of its law the case has real gains
    if known is not None and known.kind == controller:
        return known
    return controller
