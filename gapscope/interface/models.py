"""Arms and corrected arms, from what a user has at hand."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import Case, case_files, file_names, load_case
from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import real_path
from gapscope.arm.io.atomic_write import make_folder
from gapscope.arm.io.case_file import is_case
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import error_context, read_corrected_arm
from gapscope.envs.engines import check_engine
from gapscope.envs.export.formats import export as write_arm
from gapscope.envs.replay import Replay
from gapscope.envs.replay import replay as replay_recording
from gapscope.interface.result import (
    Document,
    DocumentResult,
    Result,
    TableResult,
)
from gapscope.reports.gap import gap_document, gap_tables, replay_line

Model = CorrectedArm | Sequence[AppliedEffect] | str | Path | None
"""A corrected arm, its effects, the path of a ``corrected.yaml``, or ``None`` for the nominal arm."""


def make_arm(robot: str | Path | NominalArm | Case, **sheet: Any) -> NominalArm:
    """Nominal arm from a name, a URDF or MJCF file, or a case.

    Args:
        robot: a name of ``gapscope.arm.robots.KNOWN_ROBOTS``, a file, a case or its folder.
        **sheet: the data sheet of a name or file, one value per joint: ``armature`` [kg m^2], ``coulomb`` [N m],
            ``viscous`` [N m s/rad], ``torque_limit`` [N m], ...

    Raises:
        InputError: no such robot, a data sheet that cannot be used, or one beside that of an arm or a case.

    Examples:
        >>> import gapscope
        >>> gapscope.make_arm("kuka_iiwa", coulomb=[1.0] * 7).n_joints
        7
    """
    # all other endings are models of robots, or none and a known name
    if isinstance(robot, (str, Path)) and not is_case(Path(robot)):
        return load_nominal_arm(robot, sheet=sheet)
    if sheet:
        raise InputError(
            "an arm or a case has its own data sheet",
            "leave it out here; dataclasses.replace(arm, coulomb=...) changes that of an arm",
            where=", ".join(sheet),
        )
    if isinstance(robot, NominalArm):
        return robot
    case = robot if isinstance(robot, Case) else load_case(robot, read_recordings=False)
    return case.arm


def read_corrected(
    path: str | Path, robot: str | Path | NominalArm | Case
) -> CorrectedArm:
    r"""The corrected arm of a ``corrected.yaml``, with its residual network.

    Args:
        path: of the file.
        robot: the nominal arm that the effects add to; see ``make_arm``.

    Raises:
        InputError: the file cannot be used, or names a joint that the arm does not have.

    Examples:
        >>> import gapscope, tempfile, pathlib
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "corrected.yaml"
        >>> effect = "{effect: payload, parameters: {mass: 1.0, com: [0, 0, 0.1]}}"
        >>> _ = file.write_text("schema: 1\ncase: demo\neffects: [" + effect + "]\n")
        >>> [effect.name for effect in gapscope.read_corrected(file, "kuka_iiwa").effects]
        ['payload']
    """
    return read_corrected_arm(make_arm(robot), Path(path))


def case_of(case: Case | str | Path, *, any_unit: bool = False) -> Case:
    """A case, or the one of a folder; see ``load_case``."""
    return case if isinstance(case, Case) else load_case(case, any_unit=any_unit)


def corrected_arm(arm: NominalArm, model: Model) -> CorrectedArm:
    """The arm with the effects of a model.

    Raises:
        InputError: the model names a joint that the arm does not have, or its file cannot be used.
    """
    # it has an arm of its own, which may be an identified one
    if isinstance(model, CorrectedArm):
        return model
    if isinstance(model, (str, Path)):
        return read_corrected_arm(arm, Path(model))
    return CorrectedArm(arm, tuple(model or ()))


def say_state(corrected: CorrectedArm, recording: Recording) -> None:
    """Warn if the state of an arm in a recording is not known."""
    text = corrected.taken_as(recording.name)
    if text is not None:
        warnings.warn(text, ModelWarning, stacklevel=3)


def case_file(case: Case, folder: Path) -> Path:
    """The file of a case; a case made in memory is written to ``folder/case`` first.

    Raises:
        GapscopeError: the folder cannot be written to.
    """
    # a case in memory has no file: it gets one
    return case.file or write_case(case, folder / "case", overwrite=True)


def recording_of(
    case: Case, recording: Recording | int | str | Path, *, every_row: bool = False
) -> Recording:
    """A recording of a case, by itself, its number from 0, or its name; or one in its form, by its path.

    A file in the current folder goes before a recording of the case of the same name.

    Args:
        case: the case.
        recording: which one.
        every_row: of a path, keep every row; the file then may hold no more than t and q.

    Raises:
        InputError: the case has no recording of that name, and there is no such file; or it cannot be read.
    """
    if isinstance(recording, Recording):
        return recording
    # numbers go on from those that are fitted to those that judge
    everything = (*case.recordings, *case.judged)
    if isinstance(recording, int):
        return everything[recording]
    given, path = str(recording), Path(recording)
    # behind the case file and the robot's
    files = () if case.file is None else case_files(case.file)[2:]
    names = {real_path(f): name for f, name in file_names(files, case.folder).items()}
    # a file before a name: what lies in the current folder may have no longer path
    there = os.path.lexists(path)
    name = names.get(real_path(path)) if there else given
    named = {r.name: r for r in everything}
    if name == given and given in named:
        return named[given]
    if not there:
        own = {name: file for file, name in names.items()}
        if given not in own:
            known = {**named, **own}
            raise InputError(
                "no such file, and the case has no recording of that name",
                f"{nearest(given, known)}give a path, or one of {', '.join(known)}",
                file=path,
            )
        path = own[given]
    loaded = load_recording(
        path,
        case.arm,
        case.importing,
        every_row=every_row,
        payload=case.payload_of(path),
    )
    # states of a model are told by the names that recordings have in the case
    return replace(loaded, name=name or loaded.name)


@dataclass(frozen=True, repr=False)
class Prediction(TableResult):
    """Predicted torque at every sample of a recording, N samples of n joints.

    Attributes:
        recording: name of the recording.
        t: time [s], shape (N,).
        tau: torque [N m], shape (N, n).
    """

    FILE = "prediction.csv"

    recording: str
    t: np.ndarray
    tau: np.ndarray

    def shown(self) -> str:
        """Name, number of samples and RMS of the torque per joint."""
        joints = ", ".join(
            f"J{j} {value:.3g}" for j, value in enumerate(rms(self.tau), 1)
        )
        return f"{self.recording}: {len(self.t)} samples, RMS torque in N m: {joints}"

    def table(self) -> dict[str, np.ndarray]:
        """The columns t, tau1..taun."""
        return numbered({"t": self.t, "tau": self.tau})


def predict(
    case: Case | NominalArm | str | Path,
    recording: Recording | int | str | Path = 0,
    model: Model = None,
) -> Prediction:
    """Predict the torque that would be recorded, from time, position and known payload alone.

    Args:
        case: the case; or an arm (see ``make_arm``), with a ``Recording`` beside it.
        recording: a recording, or of a case its number from 0 or its name, or the path of a file in its form.
        model: what corrects the nominal arm; see ``Model``.

    Raises:
        InputError: the arm or the model cannot be used.

    Examples:
        >>> import numpy as np, gapscope
        >>> t = np.arange(0.0, 2.0, 0.01)
        >>> q = 0.1 * np.sin(t)[:, None] * np.ones(7)
        >>> case = gapscope.Case.from_arrays("kuka_iiwa", t=t, q=q)
        >>> gapscope.predict(case).tau.shape
        (200, 7)
    """
    if isinstance(recording, Recording):
        chosen, arm = recording, make_arm(case)
    else:
        # a mistake in a program, not in a file
        if isinstance(case, NominalArm):
            raise TypeError(
                "an arm alone has no recordings: give a Recording or a case"
            )
        loaded = case_of(case)
        chosen, arm = recording_of(loaded, recording, every_row=True), loaded.arm
    # a model in effects alone adds to this arm
    corrected = corrected_arm(arm, model)
    say_state(corrected, chosen)
    torque = predict_torque(corrected, chosen)
    # with the time stamps of the file, to lie beside it
    return Prediction(chosen.name, chosen.stamps, torque)


@dataclass(frozen=True, repr=False)
class ReplayResult(TableResult):
    """A replayed motion.

    Attributes:
        recording: name of the recording.
        replay: time, position, torque and replay gap.
    """

    FILE = "replay.csv"

    recording: str
    replay: Replay

    @property
    def rmse(self) -> np.ndarray:
        """Replay gap per joint: RMS of replayed minus recorded position [rad], shape (n,)."""
        return self.replay.rmse

    def shown(self) -> str:
        """The replay gap per joint, and what moved the arm."""
        return replay_line(self.replay)

    def table(self) -> dict[str, np.ndarray]:
        """The columns t, q1..qn, tau1..taun."""
        return numbered(
            {name: getattr(self.replay, name) for name in ("t", "q", "tau")}
        )


def replay(
    case: Case | str | Path,
    recording: Recording | int | str = 0,
    model: Model = None,
    *,
    engine: str | None = None,
    progress: Progress = silent,
) -> ReplayResult:
    """Move the simulated arm under the same commands as a recording.

    The torque of a model's residual network is taken off the command.

    Args:
        case: the case, or its folder.
        recording: a recording, or its number from 0 or its name in the case.
        model: what corrects the nominal arm; see ``Model``.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        progress: called with a few words at each step.

    Raises:
        InputError: the case or the model cannot be used.
        GapscopeError: the arm cannot be simulated, or diverges.

    Examples:
        >>> import gapscope
        >>> gapscope.replay("my_arm", 0, "out/corrected.yaml").rmse  # doctest: +SKIP
    """
    loaded = case_of(case)
    chosen = recording_of(loaded, recording)
    corrected = corrected_arm(loaded.arm, model)
    say_state(corrected, chosen)
    # so that an error in an effect names the file that it stands in
    source = Path(model) if isinstance(model, (str, Path)) else None
    with error_context(source, corrected.effects):
        # inside, as an engine may refuse one of the effects
        engine = check_engine(engine)
        progress(f"replays {chosen.duration:.3g} s in {engine}")
        result = replay_recording(
            loaded.arm,
            corrected.effects,
            chosen,
            loaded.controller,
            engine=engine,
            residual=corrected.residual,
            states=corrected.states,
        )
    return ReplayResult(chosen.name, result._replace(t=chosen.stamps))


def gap(case: Case | str | Path, model: Model = None) -> DocumentResult:
    """Measure the torque gap and the replay gap of a nominal or corrected arm on every recording of a case.

    Recordings are taken as they are, even if they look as if they were in another unit; the document's ``warnings``
    say so. Of each it has ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad], per joint.

    Args:
        case: the case, or its folder.
        model: what corrects the nominal arm; see ``Model``.

    Raises:
        InputError: the case or the model cannot be used.
        GapscopeError: no recording carries a torque.

    Examples:
        >>> import gapscope
        >>> gapscope.gap("my_arm", "out/corrected.yaml").to_frame()  # doctest: +SKIP
    """
    # what looks like another unit is measured, and said in the warnings
    loaded = case_of(case, any_unit=True)
    content = gap_document(loaded, corrected_arm(loaded.arm, model))
    return DocumentResult("gap", content, gap_tables, _gap_rows)


def _gap_rows(content: Document) -> Iterator[dict[str, Any]]:
    """A row for each recording and joint."""
    for recording in content["recordings"]:
        for joint, name in enumerate(content["joints"]):
            # long form: arms of any number of joints have the same columns
            row = {"recording": recording["recording"], "joint": name}
            for key in ("torque_nrmse", "torque_rmse", "replay_rmse"):
                row[key] = None if recording[key] is None else recording[key][joint]
            yield row


@dataclass(frozen=True, repr=False)
class ExportResult(Result):
    """A file for another simulator.

    Attributes:
        corrected: the arm in it.
        file: the file.
        format: one of ``gapscope.envs.export.plain_arm.TARGETS``.
        left_out: effects that the format cannot hold; a sentence each.
        remarks: what is odd about the bodies; a sentence each.
        controller: whose gains are in it, or ``None``.
    """

    COLUMNS = ("kind", "text")

    corrected: CorrectedArm
    file: Path
    format: str
    left_out: tuple[str, ...]
    remarks: tuple[str, ...]
    controller: Controller | None = None

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the file, under the same name, into another folder."""
        make_folder(Path(folder))
        file = Path(folder) / self.file.name
        write_arm(self.corrected, self.format, file, controller=self.controller)
        return (file,)

    def shown(self) -> str:
        """The file, what it leaves out, and remarks."""
        notes = [f"left out: {text}" for text in self.left_out]
        return "\n".join([str(self.file), *notes, *self.remarks])

    def table(self) -> Iterator[tuple[str, str]]:
        """A row for each effect that is left out, and each remark."""
        yield from (("left out", text) for text in self.left_out)
        yield from (("remark", text) for text in self.remarks)


def export(
    corrected: CorrectedArm,
    file: str | Path,
    format: str | None = None,
    controller: Controller | None = None,
) -> ExportResult:
    """Write a corrected arm as URDF, MJCF or SDF, or as a snippet in the words of a simulator.

    Args:
        corrected: of a diagnosis (``result.corrected``) or a file (``gapscope.read_corrected``).
        file: the file to write.
        format: ``urdf``, ``mjcf`` or ``sdf``, by default as the ending of ``file`` says; or ``isaac_lab``, ``mjlab``,
            ``newton``, ``genesis``, ``drake``, ``gazebo``, ``ros2_control``. Others hold ranges alone, which
            ``gapscope export --randomise`` writes.
        controller: of the case (``case.controller``), whose gains a snippet then holds.

    Raises:
        InputError: no such format, or an effect that no arm can have.
        GapscopeError: the file cannot be written.

    Examples:
        >>> import gapscope, tempfile, pathlib
        >>> from gapscope.effects.corrected import CorrectedArm
        >>> arm = CorrectedArm(gapscope.make_arm("kuka_iiwa"))
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "arm.urdf"
        >>> gapscope.export(arm, file).left_out
        ()
    """
    file = Path(file)
    ending = file.suffix.removeprefix(".")
    # the one format whose ending is not its name
    form = format or {"xml": "mjcf"}.get(ending, ending)
    left_out, remarks = write_arm(corrected, form, file, controller=controller)
    return ExportResult(corrected, file, form, left_out, remarks, controller)
