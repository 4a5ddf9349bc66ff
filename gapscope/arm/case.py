"""A case: a folder with a nominal arm and its recordings."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import is_folder, real_path
from gapscope.arm.io.case_file import (
    CasePaths,
    files_of,
    known_loads,
    parse_controller,
    read_case_file,
    with_files,
)
from gapscope.arm.io.import_section import Import, parse_import
from gapscope.arm.io.load_recording import (
    Part,
    joined_in_time,
    load_recording,
    parts_of,
    recording_of_columns,
)
from gapscope.arm.io.log import check_no_log, open_log
from gapscope.arm.io.plausibility import SHORTEST_LOG, UNSIGNED
from gapscope.arm.io.table import Table, numbered, without_damage
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm, coupling_of_transmission
from gapscope.arm.recording import CHANNELS, Recording, slow_words
from gapscope.arm.robots import load_nominal_arm

# Columns of the case format from arrays in memory.


Samples = np.ndarray | Sequence[np.ndarray]
"""A channel of one recording, shape (N,) or (N, n), or a list of them: one for each recording."""


def _listed(samples: Samples) -> Sequence[np.ndarray]:
    """Arrays of a channel, one for each recording."""
    return samples if isinstance(samples, (list, tuple)) else [np.asarray(samples)]


@dataclass(frozen=True)
class Case:
    """A nominal arm and its recordings.

    Attributes:
        name: name of the case.
        folder: folder of ``case.yaml``.
        arm: the nominal arm.
        recordings: recordings that may be fitted.
        judged: held-out recordings; empty if the case has none.
        controller: the controller, if known.
        warnings: what was noticed about the whole case while reading.
        importing: how its logs are read, if they are not in the columns of the case format.
        payloads: known bodies mounted in some recordings, by the path of their file.
        file: the case file that it was read from; ``None`` for a case made in memory.
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
    file: Path | None = None

    def each(self, change: Callable[[Recording], Recording]) -> Case:
        """The case with all of its recordings changed."""
        recordings, judged = (
            tuple(map(change, part)) for part in (self.recordings, self.judged)
        )
        return replace(self, recordings=recordings, judged=judged)

    @property
    def notes(self) -> list[str]:
        """What was noticed of each recording, one that is held out too, with its name."""
        noticed = []
        for recording in (*self.recordings, *self.judged):
            every = (*recording.notes, "; ".join(filter(None, slow_words(recording))))
            noticed += [f"{recording.name}: {note}" for note in every if note]
        return noticed

    @classmethod
    def from_arrays(
        cls,
        robot: str | Path | NominalArm,
        *,
        t: Samples,
        q: Samples,
        tau: Samples | None = None,
        dq: Samples | None = None,
        q_ref: Samples | None = None,
        dq_ref: Samples | None = None,
        tau_sensor: Samples | None = None,
        temperature: Samples | None = None,
        **description: Any,
    ) -> Case:
        """A case from arrays in memory, with the checks that files get.

        One array per channel makes one recording; lists of arrays make several, one for each entry.

        Args:
            robot: path of a URDF or MJCF file, a name of ``KNOWN_ROBOTS``, or a nominal arm.
            t: time [s], shape (N,).
            q: joint positions [rad], shape (N, n).
            tau: joint torque, commanded or derived from motor current [N m], shape (N, n).
            dq: velocity [rad/s], shape (N, n).
            q_ref: reference position [rad], shape (N, n).
            dq_ref: reference velocity [rad/s], shape (N, n).
            tau_sensor: joint torque sensor [N m], shape (N, n).
            temperature: of the joints [deg C], shape (N, n).
            **description: ``name``, ``joints``, ``chain``, ``locked``, ``gravity``, ``nominal`` and ``controller`` as
                in ``case.yaml``.

        Raises:
            InputError: the robot or an array cannot be used; names recording, row and column.

        Examples:
            >>> import numpy as np
            >>> t = np.arange(0.0, 2.0, 0.01)
            >>> q = np.sin(t)[:, None] * np.ones(7)
            >>> Case.from_arrays("kuka_iiwa", t=t, q=q, tau=0 * q).recordings[0].duration
            1.99
        """
        series = (q, dq, tau, q_ref, dq_ref, tau_sensor, temperature)
        each = zip(CHANNELS, series, strict=True)
        given = {name: _listed(x) for name, x in each if x is not None}
        times = _listed(t)
        for name, arrays in given.items():
            if len(arrays) != len(times):
                raise InputError(
                    f"has {len(arrays)} recordings, t has {len(times)}",
                    "give every channel an array for each recording",
                    where=name,
                )
            for array in map(np.asarray, arrays):
                if array.ndim != 2:
                    raise InputError(
                        f"has shape {array.shape}, expected (N, n): a row for each sample, a column for each joint",
                        where=name,
                    )
        # columns t, q1..qn and so on of each recording
        frames = []
        for number, time in enumerate(times):
            own = {"t": time, **{name: x[number] for name, x in given.items()}}
            frames.append(numbered({k: np.asarray(x, float) for k, x in own.items()}))
        return cls.from_frames(robot, frames, **description)

    @classmethod
    def from_frames(
        cls,
        robot: str | Path | NominalArm,
        frames: Mapping[str, Any] | Sequence[Any] | Any,
        *,
        name: str = "case",
        joints: Sequence[str] | None = None,
        chain: Sequence[str] | None = None,
        locked: Mapping[str, float] | None = None,
        gravity: Sequence[float] | None = None,
        nominal: Mapping[str, Any] | None = None,
        controller: Mapping[str, Any] | Controller | None = None,
    ) -> Case:
        """A case from data frames in memory, with the checks that files get.

        Args:
            robot: path of a URDF or MJCF file, a name of ``KNOWN_ROBOTS``, or a nominal arm.
            frames: a data frame, or a list of them: one for each recording, with the columns of the case format
                (``t``, ``q1..qn``, ``tau1..taun``, ...). A dict of columns will do for a data frame.
            name: of the case.
            joints: order of the columns; by default that of the URDF's actuated joints.
            chain: base and tip link of an arm inside a larger tree.
            locked: positions of joints that are none of the arm's [rad or m].
            gravity: [m/s^2] in the base frame.
            nominal: the data sheet, as in ``case.yaml``.
            controller: as in ``case.yaml``.

        Raises:
            InputError: the robot or a frame cannot be used; names recording, row and column.
        """
        arm = robot
        if not isinstance(arm, NominalArm):
            arm = load_nominal_arm(
                arm,
                joints=joints,
                chain=chain,
                locked=locked,
                gravity=gravity,
                sheet=nominal,
            )
        if not isinstance(controller, Controller):
            controller = parse_controller(controller, arm.n_joints, Path(name))
        several = isinstance(frames, (list, tuple))
        recordings = []
        for number, frame in enumerate(frames if several else [frames], start=1):
            # data frames and dicts of columns alike
            columns = {str(key): np.atleast_1d(frame[key]) for key in frame}
            recording = recording_of_columns(f"recording_{number}", columns, arm)
            _check_duration(recording, Path(recording.name))
            recordings.append(recording)
        return cls(
            name=name,
            folder=Path(),
            arm=arm,
            recordings=tuple(recordings),
            controller=controller,
            warnings=_warnings(recordings),
        )

    def payload_of(self, file: Path) -> KnownLoad | None:
        """Known body that was mounted while the recording in a file was made, or ``None``."""
        return self.payloads.get(real_path(file))


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
        data_root: folder that replaces ``${GAPSCOPE_DATA}``.
        any_unit: accept recordings that look as if they were in other units, for a diagnosis of the set-up.
        read_recordings: whether to read the recordings; without them ``recordings`` and ``judged`` are empty.

    Raises:
        InputError: the case file, the URDF or a recording cannot be used; names the file and the line or field.

    Examples:
        >>> load_case("my_arm").recordings[0].duration  # doctest: +SKIP
        40.0
    """
    file = Path(path)
    # a log in place of a case is the likelier mistake than a case without its file
    check_no_log(file)
    file = file / "case.yaml" if is_folder(file) else file
    content = read_case_file(file)
    paths = CasePaths(file, data_root)
    arm = load_nominal_arm(
        paths.expand(content["robot"], "robot"),
        folder=file.parent,
        joints=content.get("joints"),
        chain=content.get("chain"),
        locked=_locked(content, paths),
        gravity=content.get("gravity"),
        sheet=content.get("nominal"),
        source=file,
    )
    # before recordings are read, so that a list of wrong length is found at once
    section = dict(content.get("import") or {})
    if "calibration" in section:
        place = paths.expand(section["calibration"], "import.calibration")
        section["calibration"] = str(place)
    importing = parse_import(section, arm.n_joints, file) if section else None
    # the transmission of a log also says which motors turn several joints
    arm = _with_coupling(arm, importing)
    payloads = known_loads(content, paths)
    recordings, judged = list[Recording](), list[Recording]()
    if read_recordings:
        recordings, judged = _recordings(
            content, paths, arm, importing, payloads, any_unit
        )
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
        file=file,
    )


def _locked(content: Mapping[str, Any], paths: CasePaths) -> dict[str, float]:
    """Where joints stand that are none of the arm's [rad or m], by name, as ``locked:`` says.

    A number is the position; a text names a column of the first recording, whose mean is taken.

    Raises:
        InputError: no table of that recording has the column.
    """
    positions, tables = dict(content.get("locked") or {}), list[Table]()
    for name, column in positions.items():
        if not isinstance(column, str):
            continue
        first = paths.entry(content["recordings"][0], "recordings")
        files = list(first.values()) if isinstance(first, dict) else [first]
        # read once, and only if a column is named
        tables = tables or [table for file in files for table in open_log(file).tables]
        holding = [table for table in tables if column in table.columns]
        if not holding:
            raise InputError(
                f"no table of {', '.join(map(str, files))} has a column {column!r}",
                "name a column, or give the position as a number",
                file=paths.file,
                where=f"field locked.{name}",
            )
        # the mean: an arm's other joints stand still, or are taken as if they did
        positions[name] = np.mean(without_damage(holding[0]).numbers(column))
    return {name: float(position) for name, position in positions.items()}


def _with_coupling(arm: NominalArm, importing: Import | None) -> NominalArm:
    """The arm with the coupled motors that the transmission of its logs shows, unless its data sheet says which."""
    # what the data sheet says goes before what follows from a log
    if arm.coupling is not None or importing is None or importing.transmission is None:
        return arm
    turned = importing.turned
    # from the log's directions of the joints to those of the URDF
    signs = 1.0 if turned is None else np.array(turned.motion.factor)
    matrix = coupling_of_transmission(importing.transmission, signs)
    return replace(arm, coupling=matrix)


def _recordings(
    content: Mapping[str, Any],
    paths: CasePaths,
    arm: NominalArm,
    importing: Import | None,
    payloads: Mapping[Path, KnownLoad],
    any_unit: bool,
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit and those held out: parts of each file, or whole files under ``judge:``."""

    def read(part: Part) -> Recording:
        """One recording, with the known body that was mounted."""
        (entry, chosen), files = part, _files(part)
        # of files side by side any may be the one that the load is named with
        loads = [payloads.get(real_path(file)) for file in files]
        recording = load_recording(
            entry,
            arm,
            importing,
            **chosen,
            complete=True,
            any_unit=any_unit,
            payload=next(filter(None, loads), None),
        )
        _check_duration(recording, files[0])
        name = names[files[0]].removesuffix(files[0].name) + recording.name
        return replace(recording, name=name)

    parts = importing or Import()
    entries = [paths.entry(entry, "recordings") for entry in content["recordings"]]
    fitted, judged = (
        [part for entry in entries for part in parts_of(entry, parts, use)]
        for use in ("fit", "judge")
    )
    for text in content.get("judge", []):
        # a whole file: ranges of rows and episodes are those of recordings:
        judged += parts_of(paths.entry(text, "judge"), Import(), "fit")
    firsts = [_files(part)[0] for part in (*fitted, *judged)]
    names = file_names(firsts, paths.file.parent)
    # fitted and held out together: a file may go on where one of the others ended
    found = joined_in_time([read(part) for part in (*fitted, *judged)])
    recordings, held_out = found[: len(fitted)], found[len(fitted) :]
    # a judge that has been fitted would judge nothing, whatever its name
    pairs = zip(fitted, recordings, strict=True), zip(judged, held_out, strict=True)
    for (part, one), (held, other) in product(*pairs):
        if _overlap(part, held) or _same_content(one, other):
            raise InputError(
                f"{other.name} is held out and is fitted too, as {one.name}",
                "take it out of judge: or of recordings:, or give ranges of rows: that do not overlap",
                file=paths.file,
                where="judge",
            )
    return recordings, held_out


def file_names(files: Iterable[Path], folder: Path) -> dict[Path, str]:
    """What files are called in a case: by their names, those that share one by their paths from the case's folder."""
    places = dict.fromkeys(files)
    count = Counter(place.name for place in places)
    return {
        place: place.name
        if count[place.name] == 1
        else Path(os.path.relpath(place, folder)).as_posix()
        for place in places
    }


def _files(part: Part) -> list[Path]:
    """A file, or files side by side."""
    entry, _ = part
    return [entry] if isinstance(entry, Path) else list(entry.values())


def _overlap(one: Part, other: Part) -> bool:
    """Whether two parts have rows of one file in common, more than the one where a range ends and the next begins."""
    (_, first), (_, second) = one, other
    if first.get("episode") != second.get("episode"):
        return False
    starts, ends = zip(
        *(x.get("rows") or (0, np.inf) for x in (first, second)), strict=True
    )
    same = list(map(real_path, _files(one))) == list(map(real_path, _files(other)))
    return same and max(starts) < min(ends)


def _same_content(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same motion with the same torque, whatever their names."""
    # positions first, which differ at once between two motions
    if not np.array_equal(one.q, other.q):
        return False
    first, second = (np.zeros(0) if r.tau is None else r.tau for r in (one, other))
    # a copy may have other dates
    alike = np.allclose(one.t - one.t[0], other.t - other.t[0])
    return alike and np.array_equal(first, second)


def case_files(path: str | Path) -> tuple[Path, ...]:
    """Files that a case is read from: the case file, the robot's, calibration, recordings with every file of a folder.

    Raises:
        InputError: the case file or the robot cannot be used.
    """
    case = load_case(path, read_recordings=False)
    file = case.file
    assert file is not None
    content, paths = read_case_file(file), CasePaths(file, None)
    found = [file, case.arm.urdf]

    def add(field: str, name: str) -> str:
        """Files of a name, but for the robot's, and loads, which name recordings again."""
        if field not in ("robot", "payloads"):
            found.extend(files_of(file.parent / paths.expand(name, field)))
        return name

    with_files(content, add)
    return tuple(found)


def _check_duration(recording: Recording, file: Path) -> None:
    if recording.duration < SHORTEST_LOG:
        raise InputError(
            f"lasts {recording.duration:.3g} s ({len(recording.t)} samples), expected at least {SHORTEST_LOG:g} s",
            "record a longer motion; ten seconds in which all joints move are a good start",
            file=file,
        )


def _warnings(recordings: list[Recording]) -> tuple[str, ...]:
    """What concerns the whole case among the notes of its recordings."""
    unsigned = ", ".join(r.name for r in recordings if UNSIGNED in r.notes)
    return (f"{unsigned}: {UNSIGNED}",) if unsigned else ()
