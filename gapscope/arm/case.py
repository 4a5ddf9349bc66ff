"""A case: a folder with a nominal arm and its recordings."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_case_file
from gapscope.arm.io.controller_file import parse_controller
from gapscope.arm.io.import_section import Import, parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.plausibility import UNSIGNED
from gapscope.arm.known_load import KnownLoad, parse_payloads
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm

SHORTEST = 1.0
"""Duration of the shortest recording that a case may hold [s]; both ends are trimmed by 0.3 s for the gap."""

DATA_ROOT = "GAPSCOPE_DATA"
"""Environment variable with the folder that ``${GAPSCOPE_DATA}`` in a path of a case stands for."""


@dataclass(frozen=True)
class Case:
    """A nominal arm and its recordings.

    Attributes:
        name: name of the case.
        folder: folder of ``case.yaml``.
        arm: the nominal arm.
        recordings: what may be fitted.
        judged: what may only be judged on; empty where the case does not set any aside.
        controller: the controller, where known.
        warnings: what was noticed about the whole case while reading.
        importing: how its logs are read, where they are not in the columns of the case format.
        payloads: known bodies mounted in some recordings, by the path of their file.
    """

    name: str
    folder: Path
    arm: NominalArm
    recordings: tuple[Recording, ...]
    judged: tuple[Recording, ...] = ()
    controller: Controller | None = None
    warnings: tuple[str, ...] = ()
    importing: Import | None = None
    payloads: Mapping[Path, KnownLoad] = field(default_factory=dict)

    def payload_of(self, file: Path) -> KnownLoad | None:
        """Known body that was mounted while the recording in a file was made, or ``None``."""
        return self.payloads.get(file.resolve())


def load_case(
    path: str | Path,
    *,
    data_root: Path | None = None,
    read_recordings: bool = True,
    any_unit: bool = False,
) -> Case:
    """Read a case.

    A path in it may start with ``${GAPSCOPE_DATA}``: the folder ``data_root``, else the environment variable of that
    name, else ``shared/data`` beside the repository that holds the case file two folders below its top.

    Args:
        path: case folder, or the case file in it.
        data_root: folder that ``${GAPSCOPE_DATA}`` stands for.
        any_unit: accept recordings that look as if they were in other units, for a diagnosis of the set-up.
        read_recordings: whether to read the recordings; without them ``recordings`` and ``judged`` are empty.

    Raises:
        InputError: the case file, the URDF or a recording cannot be used; names the file and the line or field.
    """
    file = Path(path)
    file = file / "case.yaml" if file.is_dir() else file
    content = read_case_file(file)
    paths = _Paths(file, data_root)
    arm = load_nominal_arm(
        paths.expand(content["robot"], "robot"),
        folder=file.parent,
        joints=content.get("joints"),
        gravity=content.get("gravity"),
        sheet=content.get("nominal"),
        source=file,
    )
    section = content.get("import")
    importing = parse_import(section, arm.n_joints, file) if section else None
    fit = importing.fit if importing else ()
    judge = importing.judge if importing else ()
    payloads = _payloads(content, paths)
    read = partial(
        _read, arm=arm, importing=importing, any_unit=any_unit, payloads=payloads
    )
    recordings: list[Recording] = []
    judged: list[Recording] = []
    if read_recordings:
        entries = [paths.entry(entry, "recordings") for entry in content["recordings"]]
        recordings = [read(entry, rows) for entry in entries for rows in fit or (None,)]
        judged = [read(entry, rows) for entry in entries for rows in judge]
        judged += [
            read(paths.entry(entry, "judge"), None)
            for entry in content.get("judge", [])
        ]
    return Case(
        name=content["name"],
        folder=file.parent,
        arm=arm,
        recordings=tuple(recordings),
        judged=tuple(judged),
        controller=parse_controller(content.get("controller"), arm.n_joints, file),
        warnings=_warnings([*recordings, *judged]),
        importing=importing,
        payloads=payloads,
    )


def case_files(path: str | Path, *, data_root: Path | None = None) -> tuple[Path, ...]:
    """Files that a case is read from: the case file, the robot's, its recordings with every file of a bag's folder.

    Raises:
        InputError: the case file or the robot cannot be used.
    """
    case = load_case(path, data_root=data_root, read_recordings=False)
    file = Path(path) / "case.yaml" if Path(path).is_dir() else Path(path)
    content, paths = read_case_file(file), _Paths(file, data_root)
    found = [file, case.arm.urdf]
    for part in ("recordings", "judge"):
        for entry in content.get(part, []):
            where = paths.entry(entry, part)
            for place in where.values() if isinstance(where, dict) else (where,):
                found += (
                    sorted(p for p in place.rglob("*") if p.is_file())
                    if place.is_dir()
                    else [place]
                )
    return tuple(found)


@dataclass(frozen=True)
class _Paths:
    """Paths of a case file, from their text."""

    file: Path
    data_root: Path | None

    def expand(self, text: str, field: str) -> Path:
        """A path with ``${GAPSCOPE_DATA}`` filled in; relative ones stay relative to the case's folder."""
        mark = "${" + DATA_ROOT + "}"
        if mark not in text:
            return Path(text)
        beside = self.file.resolve().parent.parent.parent.parent / "shared" / "data"
        root = Path(self.data_root or os.environ.get(DATA_ROOT) or beside)
        if not root.is_dir():
            raise InputError(
                f"{mark} stands for {root}, which is no folder",
                f"set the environment variable {DATA_ROOT} to the folder with the data sets",
                file=self.file,
                where=f"field {field}",
            )
        return Path(text.replace(mark, str(root.resolve())))

    def entry(
        self, entry: str | Mapping[str, str], field: str
    ) -> Path | dict[str, Path]:
        """Path of a recording, or the paths of its files by label."""
        if isinstance(entry, str):
            return self.file.parent / self.expand(entry, field)
        return {
            label: self.file.parent / self.expand(text, field)
            for label, text in entry.items()
        }


def _payloads(content: Mapping[str, Any], paths: _Paths) -> dict[Path, KnownLoad]:
    """Known bodies by the path of a recording's file; of several files side by side any may be named."""
    named: dict[str, Path] = {}
    if not content.get("payloads"):
        return {}
    for part in ("recordings", "judge"):
        for entry in content.get(part, []):
            for text in [entry] if isinstance(entry, str) else entry.values():
                named[text] = paths.file.parent / paths.expand(text, part)
    loads = parse_payloads(content.get("payloads"), named, paths.file)
    return {named[text].resolve(): load for text, load in loads.items()}


def _read(
    entry: Path | dict[str, Path],
    rows: tuple[int, int] | None,
    *,
    arm: NominalArm,
    importing: Import | None,
    any_unit: bool,
    payloads: Mapping[Path, KnownLoad],
) -> Recording:
    """One recording of a case, with the known body that was mounted."""
    recording = load_recording(
        entry, arm, importing, rows=rows, complete=True, any_unit=any_unit
    )
    files = [entry] if isinstance(entry, Path) else list(entry.values())
    loads = [payloads[file.resolve()] for file in files if file.resolve() in payloads]
    if loads:
        recording = replace(recording, payload=loads[0])
    if recording.duration < SHORTEST:
        file = files[0]
        raise InputError(
            f"lasts {recording.duration:.3g} s ({len(recording.t)} samples), expected at least {SHORTEST:g} s",
            "record a longer motion; ten seconds in which all joints move are a good start",
            file=file,
        )
    return recording


def _warnings(recordings: list[Recording]) -> tuple[str, ...]:
    unsigned = [
        recording.name for recording in recordings if UNSIGNED in recording.notes
    ]
    return (f"{', '.join(unsigned)}: {UNSIGNED}",) if unsigned else ()
