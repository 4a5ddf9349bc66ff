"""Real arms and sample cases, from the folder GAPSCOPE_DATA, to measure against."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording

CASES = Path(__file__).parents[1] / "cases"
REAL = (
    "kinova_gen3_current",
    "kuka_med7",
    "panda",
    "staubli_tx40",
    "unitree_z1",
    "ur10",
)
"""Real arms, each with its file in ``experiments/cases``."""
SPLIT = ("ur10", "unitree_z1")
"""Of these the first part of a recording is the reference for the rest of it."""
SHARE = 0.3
"""The part that is the reference [1]."""


@dataclass(frozen=True)
class Measured:
    """A case, and a reference if it is diagnosed against one."""

    name: str
    case: Path
    reference: Path | None = None


def data_folder() -> Path | None:
    """The folder of the recordings, if there is one."""
    folder = Path(os.environ.get("GAPSCOPE_DATA", ""))
    return folder if "GAPSCOPE_DATA" in os.environ and folder.is_dir() else None


def sample_cases() -> list[Measured]:
    """Cases from a simulator that shares no code with the project."""
    data = data_folder()
    folders = sorted((data / "sample_cases").glob("case*")) if data else []
    return [Measured(folder.name, folder) for folder in folders]


def real_cases() -> list[Measured]:
    """The real arms whose recordings are there."""
    if data_folder() is None:
        return []
    return [Measured(name, CASES / f"{name}.yaml") for name in REAL]


def split_case(name: str, folder: Path) -> Measured:
    """A real arm against a reference: the first part of each recording, and the rest."""
    first, rest = folder / f"{name}_reference", folder / f"{name}_rest"
    if not (rest / "case.yaml").is_file():
        case = load_case(CASES / f"{name}.yaml", any_unit=True)
        parts = [_parts(recording) for recording in case.recordings]
        for place, k in ((first, 0), (rest, 1)):
            recordings = tuple(part[k] for part in parts)
            cut = replace(case, name=place.name, recordings=recordings, judged=())
            write_case(cut, place, ending="npz", overwrite=True)
    return Measured(f"{name} against its first part", rest, first)


def _parts(recording: Recording) -> tuple[Recording, Recording]:
    count = int(SHARE * len(recording.t))
    return recording.part(slice(None, count)), recording.part(slice(count, None))
