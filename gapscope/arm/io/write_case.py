"""Cases and recordings back into files, complete or not at all: each is written aside and then renamed."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.atomic_write import atomic_write, folder_aside
from gapscope.arm.io.case_file import controller_section
from gapscope.arm.io.locked_section import LOCK
from gapscope.arm.io.table import numbered
from gapscope.arm.nominal import SHEET_UNITS, NominalArm, coupling_entries
from gapscope.arm.recording import Recording


def write_recording(recording: Recording, path: str | Path) -> Path:
    """Write a recording in the columns of the case format, without loss; the ending says which format.

    Args:
        recording: what to write; its name and notes are not kept.
        path: file that ends in ``.csv``, ``.parquet`` or ``.npz``; one that exists is replaced.

    Raises:
        InputError: another ending.
        GapscopeError: the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".csv", ".parquet", ".npz"):
        raise InputError(
            f"the ending {path.suffix!r} names no format to write",
            "end it in .csv, .parquet or .npz",
            file=path,
        )
    channels: dict[str, Any] = {"t": recording.stamps, **recording.channels}
    if path.suffix == ".csv":
        write_columns(numbered(channels), path)
        return path
    with atomic_write(path) as aside:
        if path.suffix == ".npz":
            np.savez_compressed(aside, **channels)
        else:
            import pyarrow as pa
            import pyarrow.parquet as pq

            pq.write_table(pa.table(numbered(channels)), aside)
    return path


def write_columns(columns: dict[str, np.ndarray], path: str | Path) -> None:
    """Write columns of equal length as CSV, without loss.

    Raises:
        GapscopeError: the file cannot be written.
    """
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with (
        atomic_write(path) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def check_csv(path: Path) -> None:
    """Check the ending before any work is done; raises ``InputError``."""
    if path.suffix != ".csv":
        raise InputError(
            f"the ending {path.suffix!r} is not .csv", "end it in .csv", file=path
        )


def write_case(
    case: Case,
    folder: str | Path,
    *,
    overwrite: bool = False,
    ending: str = "csv",
    beside: Callable[[Path], None] = lambda folder: None,
) -> Path:
    """Write a case as a folder of its own: ``case.yaml``, a copy of the URDF, and the recordings.

    Args:
        case: what to write; the recordings are written as they were understood, so no import section is needed.
        folder: folder to make.
        overwrite: whether a case that is there already may be replaced.
        ending: of the recordings' files, ``csv``, ``parquet`` or ``npz``.
        beside: called with the folder before it gets its name, to write what has to be there with the case.

    Returns:
        Path of the case file.

    Raises:
        InputError: the folder exists and is not to be replaced, or is something else than a case; another ending.
        GapscopeError: the folder cannot be written.
    """
    folder = Path(folder)
    if is_used(folder):
        if not (folder / "case.yaml").is_file():
            raise InputError(
                "exists and is not a case", "choose a new folder", file=folder
            )
        if not overwrite:
            raise InputError(
                "holds a case already",
                "choose a new folder, or allow to overwrite it",
                file=folder,
            )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # into a folder beside it: the case is there whole, or the old one stays
        with folder_aside(folder) as aside:
            fresh, old = aside / "new", aside / "old"
            fresh.mkdir()
            _fill(case, fresh, ending)
            beside(fresh)
            # the old one out of the way, the new one in its place: two renames
            if folder.exists():
                folder.rename(old)
            fresh.rename(folder)
    except OSError as error:
        raise GapscopeError(
            f"{folder}: cannot be written ({error})", "check the folder's permissions"
        ) from None
    return folder / "case.yaml"


def is_used(folder: Path) -> bool:
    """Whether a place holds anything but the lock of a run: the one that asks, or one that was killed."""
    if not folder.is_dir():
        return folder.exists()
    return any(path.name != LOCK for path in folder.iterdir())


def _fill(case: Case, folder: Path, ending: str) -> None:
    """Write all files of a case into an empty folder."""
    shutil.copyfile(case.arm.urdf, folder / "robot.urdf")
    recordings = (*case.recordings, *case.judged)
    names = _file_names([recording.name for recording in recordings], ending)
    silent = [recording.tau is None for recording in recordings]
    for recording, name in zip(recordings, names, strict=True):
        # beside others with torque: zeros throughout are read as none
        if recording.tau is None and not all(silent):
            recording = replace(recording, tau=np.zeros_like(recording.q))
        write_recording(recording, folder / name)
    fitted = len(case.recordings)
    payloads = {
        name: recording.payload.entry()
        for name, recording in zip(names, recordings, strict=True)
        if recording.payload is not None
    }
    content: dict[str, Any] = {
        "name": case.name,
        "robot": "robot.urdf",
        "joints": list(case.arm.joints),
        "gravity": case.arm.gravity.tolist(),
        "nominal": nominal_section(case.arm),
        "locked": dict(case.arm.locked),
        "controller": case.controller and controller_section(case.controller),
        "recordings": names[:fitted],
        "judge": names[fitted:],
        "payloads": payloads,
        # a case is expected to hold torque unless its import section excludes it
        "import": {"tau": None} if all(silent) else {},
    }
    content = {key: value for key, value in content.items() if value}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    (folder / "case.yaml").write_text(text, encoding="utf-8")


def _file_names(labels: Iterable[str], ending: str) -> list[str]:
    """A file name for each recording, all different."""
    names: list[str] = []
    for label in labels:
        # "robot_1.csv rows 0-99" and the like: no ending within the name, no blanks
        plain = re.sub(r"\.(csv|tsv|txt|parquet|npz|db3|mcap|h5|hdf5|mat)\b", "", label)
        stem = re.sub(r"\W+", "_", plain).strip("_") or "recording"
        # two labels may differ only in signs that a file name cannot have
        alike = [n for n in names if n.startswith((f"{stem}.", f"{stem}__"))]
        names.append(f"{stem}{f'__{len(alike) + 1}' if alike else ''}.{ending}")
    return names


def nominal_section(arm: NominalArm) -> dict[str, Any]:
    """The ``nominal:`` section of an arm: rotors, friction, torque limits, encoders."""
    known = {name: getattr(arm, name) for name in SHEET_UNITS}
    section: dict[str, Any] = {
        **{name: x if x is None else x.tolist() for name, x in known.items()},
        "encoder": arm.encoder,
        "encoder_step": arm.encoder_step,
        "coupling": None if arm.coupling is None else coupling_entries(arm.coupling),
    }
    return {key: value for key, value in section.items() if value not in (None, [])}
