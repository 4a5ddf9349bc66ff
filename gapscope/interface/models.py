"""Arms and corrected arms, from what a user has at hand."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import is_folder
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm

Model = CorrectedArm | Sequence[AppliedEffect] | str | Path | None
"""A corrected arm, its effects, the path of a ``corrected.yaml``, or ``None`` for the nominal arm."""


def make_arm(robot: str | Path | NominalArm | Case, **sheet: Any) -> NominalArm:
    """Nominal arm from a name, a URDF or MJCF file, or a case.

    Args:
        robot: a name of ``gapscope.arm.robots.KNOWN_ROBOTS``, a file, a case or its folder.
        **sheet: the data sheet, one value per joint: ``armature`` [kg m^2], ``coulomb`` [N m], ``viscous``
            [N m s/rad], ``torque_limit`` [N m], ...

    Raises:
        InputError: no such robot, or a data sheet that cannot be used.

    Examples:
        >>> import gapscope
        >>> gapscope.make_arm("kuka_iiwa", coulomb=[1.0] * 7).n_joints
        7
    """
    if isinstance(robot, Case):
        return robot.arm
    if isinstance(robot, NominalArm):
        return robot
    path = Path(robot)
    if path.suffix in (".yaml", ".yml") or is_folder(path):
        return load_case(path, read_recordings=False).arm
    return load_nominal_arm(robot, sheet=sheet)


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
    return case.file or write_case(case, folder / "case", overwrite=True)


def recording_of(
    case: Case, recording: Recording | int | str | Path, *, every_row: bool = False
) -> Recording:
    """A recording of a case, by itself, its number from 0, or its name; or one in its form, by its path.

    Args:
        case: the case.
        recording: which one.
        every_row: of a path, keep every row; the file then may hold no more than t and q.

    Raises:
        InputError: the case has no recording of that name, and there is no such file; or it cannot be read.
    """
    if isinstance(recording, Recording):
        return recording
    everything = (*case.recordings, *case.judged)
    if isinstance(recording, int):
        return everything[recording]
    named = {r.name: r for r in everything}
    if str(recording) in named:
        return named[str(recording)]
    path = Path(recording)
    check_recording(path, named)
    return load_recording(
        path,
        case.arm,
        case.importing,
        every_row=every_row,
        payload=case.payload_of(path),
    )


def check_recording(path: Path, named: Collection[str]) -> None:
    """Check that a recording that is none of a case's by its name is there.

    Raises:
        InputError: it is not.
    """
    if not os.path.lexists(path):
        raise InputError(
            "no such file, and the case has no recording of that name",
            f"{nearest(str(path), named)}give a path, or one of {', '.join(named)}",
            file=path,
        )
