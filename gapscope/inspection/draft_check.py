"""The drafted case, read once: whether it can be, and which faults of the set-up its torque shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.inspection.draft import case_text
from gapscope.inspection.inspection import Inspection


@dataclass(frozen=True)
class DraftCheck:
    """What reading the drafted case showed.

    Attributes:
        faults: set-up faults that the torque shows, in words.
        notes: what the reader noticed, and dropped.
        problem: why the case cannot be read as it is; empty if it can.
    """

    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""


def check_draft(found: Inspection) -> DraftCheck:
    """Read the drafted case, and look for faults of the set-up if it has a torque."""
    if found.arm is None:
        return DraftCheck(problem="no robot is known: the torque cannot be judged")
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "case.yaml"
        text = case_text(found, Path(folder), str(found.arm.urdf.resolve()))
        file.write_text(text, encoding="utf-8")
        try:
            case = load_case(file, any_unit=True)
            faults: tuple[FoundFault, ...] = ()
            if any(recording.tau is not None for recording in case.recordings):
                faults = find_setup_faults(case)
            return DraftCheck(tuple(map(str, faults)), _notes(case))
        except GapscopeError as error:
            return DraftCheck(problem=str(error).replace(str(file), "case.yaml"))


def _notes(case: Case) -> tuple[str, ...]:
    """Notes of each recording, with its name."""
    notes = []
    for recording in case.recordings:
        notes += [f"{recording.name}: {note}" for note in recording.notes]
    return tuple(notes)
