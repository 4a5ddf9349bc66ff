"""The next recording of a case: files in, files out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import read_json
from gapscope.arm.known_load import KnownLoad
from gapscope.commands.diagnose import make_folder
from gapscope.diagnosis.advice.next_recording import Advice, Request, advise
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_corrected
from gapscope.ident.excitation.trajectory_files import write_csv, write_joint_trajectory
from gapscope.reports.trajectory.page import write_picture

Findings = tuple[Mapping[str, Any], tuple[AppliedEffect, ...]]


def check_out(out: Path) -> None:
    """Check the ending before any work is done; raises ``InputError``."""
    if out.suffix != ".csv":
        raise InputError(
            f"the ending {out.suffix!r} is not .csv", "end it in .csv", file=out
        )


def findings(
    case_path: Path,
    folder: Path | None,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[Case, Findings]:
    """A case with its diagnosis and the effects found: from the folder of a diagnosis, or diagnosed now.

    Raises:
        InputError: the case, or the folder, cannot be used.
    """
    progress("reads the case")
    case = load_case(case_path, any_unit=True)
    if folder is None:
        result = diagnose(case, progress)
        return case, (result.document, result.effects)
    document = _document(folder / "diagnosis.json")
    joints = len(document["gap"]["before"]["torque_nrmse"])
    if joints != case.arm.n_joints:
        raise InputError(
            f"is of an arm with {joints} joints, the case {case.name} has {case.arm.n_joints}",
            "give the folder that gapscope diagnose wrote for this case",
            file=folder / "diagnosis.json",
        )
    return case, (document, read_corrected(folder / "corrected.yaml"))


def payload_of(mass: float | None, centre: str) -> KnownLoad | None:
    """The payload of the options ``--payload`` and ``--payload-com``, or ``None`` where no mass is given.

    Raises:
        InputError: the centre is not three numbers, or the mass is not above zero.
    """
    if mass is None:
        return None
    try:
        x, y, z = (float(part) for part in centre.split(","))
    except ValueError:
        raise InputError(
            f"{centre!r} is no centre of mass",
            "give x,y,z in m, such as 0,0,0.05",
            where="payload-com",
        ) from None
    if mass == 0:
        raise InputError(
            "a payload of 0 kg is none", "give its mass in kg", where="payload"
        )
    return KnownLoad(mass, (x, y, z))


def write_advice(
    case: Case,
    found: Findings,
    request: Request,
    out: Path,
    progress: Callable[[float, float], None],
) -> tuple[Advice, list[Path]]:
    """Design the next recording and write it, as ``gapscope excite`` does; no files where none is needed.

    Raises:
        InputError: the limits allow no trajectory.
        GapscopeError: a file cannot be written.
    """
    advice = advise(case, *found, request, progress)
    if advice.excitation is None or advice.plan is None:
        return advice, []
    make_folder(out.resolve().parent)
    paths = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    write_csv(advice.excitation.motion, paths[0])
    write_joint_trajectory(advice.excitation.motion, case.arm.joints, paths[1])
    write_picture(advice.excitation, case.arm, advice.plan, paths[2])
    return advice, paths


def _document(path: Path) -> Mapping[str, Any]:
    remedy = "give the folder that gapscope diagnose wrote"
    content = read_json(path, remedy)
    if not isinstance(content, dict):
        raise InputError("is no diagnosis", remedy, file=path)
    try:
        validate(content)
    except GapscopeError as error:
        raise InputError(error.message, remedy, file=path) from None
    return content
