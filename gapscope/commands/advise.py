"""The command ``gapscope advise``: the next recording of a case."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapscope.arm.errors import InputError
from gapscope.commands.options import (
    CasePath,
    Folder,
    Limits,
    Positive,
    Rate,
    SearchSeed,
    Trajectory,
)
from gapscope.terminal import Progress, console, log, say, wrote

if TYPE_CHECKING:
    from gapscope.arm.case import Case
    from gapscope.arm.known_load import KnownLoad
    from gapscope.effects.applied import AppliedEffect

    Findings = tuple[Mapping[str, Any], tuple[AppliedEffect, ...]]


def advise(
    case: CasePath,
    *,
    out: Trajectory,
    diagnosis: Folder | None = None,
    payload: float | None = None,
    payload_com: str = "0,0,0",
    fastest: float = 5.0,
    rate: Rate = 250.0,
    evaluations: Positive = 1000,
    limits: Limits,
    seed: SearchSeed = None,
) -> None:
    """Design the recording that separates what is still confounded.

    Args:
        diagnosis: folder that diagnose wrote for this case; default: diagnose it now
        payload: mass of a known body that could be mounted; used if it separates better [kg]
        payload_com: its centre in the frame of the joint that moves the last link, x,y,z [m]
        fastest: highest frequency that the controller follows [Hz]
        evaluations: objective evaluations, over all speeds and loads
    """
    from gapscope.arm.io.atomic_write import make_folder
    from gapscope.commands.search_progress import SearchProgress
    from gapscope.diagnosis.document.expected import planned_entries
    from gapscope.diagnosis.next_recording import AdviceRequest, lines
    from gapscope.diagnosis.next_recording import advise as advise_case
    from gapscope.reports.expected import expected_table
    from gapscope.reports.trajectory import (
        check_csv,
        margin_lines,
        margin_table,
        write_trajectory,
    )

    check_csv(out)
    load = read_payload(payload, payload_com)
    request = AdviceRequest(limits, load, fastest, rate, evaluations, seed)
    label = case.name or str(case)
    with Progress(label) as progress:
        loaded, (document, effects) = read_findings(case, diagnosis, progress)
    paths: list[Path] = []
    with SearchProgress(label, "separation", log) as search:
        advice = advise_case(loaded, document, effects, request, search)
        if advice.excitation is not None and advice.plan is not None:
            make_folder(out.resolve().parent)
            paths = write_trajectory(advice.excitation, loaded.arm, advice.plan, out)
    if advice.excitation is not None:
        console.print(margin_table(advice.excitation))
        say(*margin_lines(advice.excitation))
        load = advice.option.payload if advice.option else None
        expected = planned_entries(loaded.arm, advice.excitation, load)
        console.print(expected_table(expected, loaded.arm.n_joints))
    say(*lines(advice, document))
    wrote(*paths)


def read_findings(
    case_path: Path, folder: Path | None, progress: Callable[[str], None]
) -> tuple[Case, Findings]:
    """A case with its diagnosis and the effects found: from the folder of a diagnosis, or diagnosed now.

    Raises:
        InputError: the case, or the folder, cannot be used.
    """
    from gapscope.arm.case import load_case
    from gapscope.diagnosis.diagnose import diagnose
    from gapscope.diagnosis.document.diagnosis_json import read_document
    from gapscope.effects.corrected_file import read_corrected

    progress("reads the case")
    case = load_case(case_path, any_unit=True)
    if folder is None:
        result = diagnose(case, progress)
        return case, (result.document, result.effects)
    document = read_document(folder / "diagnosis.json")
    joints = len(document["gap"]["before"]["torque_nrmse"])
    if joints != case.arm.n_joints:
        raise InputError(
            f"is of an arm with {joints} joints, the case {case.name} has {case.arm.n_joints}",
            "give the folder that gapscope diagnose wrote for this case",
            file=folder / "diagnosis.json",
        )
    return case, (document, read_corrected(folder / "corrected.yaml"))


def read_payload(mass: float | None, centre: str) -> KnownLoad | None:
    """The payload of the options ``--payload`` and ``--payload-com``, or ``None`` if no mass is given.

    Raises:
        InputError: the centre is not three numbers, or the mass is not above zero.
    """
    from gapscope.arm.known_load import KnownLoad

    if mass is None:
        return None
    try:
        x, y, z = (float(part) for part in centre.split(","))
    except ValueError:
        raise InputError(
            f"{centre!r} is no centre of mass",
            "give x,y,z in m, such as 0,0,0.05",
            where="--payload-com",
        ) from None
    if mass == 0:
        raise InputError(
            "a payload of 0 kg is none", "give its mass in kg", where="--payload"
        )
    return KnownLoad(mass, (x, y, z))
