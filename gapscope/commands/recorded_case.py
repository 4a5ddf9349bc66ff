"""A case from a simulated arm: the effects of a file, recorded, with the truth beside the case or sealed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control import LAWS
from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import make_folder
from gapscope.arm.io.case_file import read_controller
from gapscope.arm.io.locked_section import locked
from gapscope.arm.io.write_case import is_used, write_case
from gapscope.arm.nearest_name import check_known, nearest
from gapscope.arm.nominal import NominalArm
from gapscope.commands.inputs import read_arm_and_controller
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.corrected_file import (
    error_context,
    read_with_faults,
    write_corrected,
)
from gapscope.effects.setup_faults import Fault
from gapscope.envs.recorder import Plan, hidden_by_reading_back, record_case

ENDINGS = ("csv", "parquet", "npz")
"""Formats of the recordings."""
TRUTH = "truth.yaml"
"""File with the effects of a recorded case."""


def record_files(
    robot: str,
    effects: Path,
    out: Path,
    plan: Plan,
    *,
    controller: str | None = None,
    seed: int | None = None,
    ending: str = "csv",
    sealed: Path | None = None,
    progress: Progress = silent,
) -> tuple[list[Path], str | None]:
    """Record a simulated arm with effects as a case.

    Args:
        robot: a name or URDF; or a case, whose nominal arm and controller are taken.
        effects: file of the form of ``corrected.yaml``, with setup faults as ``diagnosis.json`` has them.
        out: folder of the case; must not hold one already.
        plan: how to record.
        controller: a control law, with the gains of a case that has it or else gains that fit the arm; or a YAML file
            in the form of the ``controller:`` section of a case; by default that of a case, else pd.
        seed: of motions and noise; by default another one each time. It is not written anywhere.
        ending: one of ``ENDINGS``.
        sealed: folder for the truth, outside the case; by default the truth lies in the case's folder.
        progress: called with a few words at each step.

    Returns:
        The case file and the truth's file, and what the user should know about the torque recorded, or ``None``.

    Raises:
        InputError: an argument or file is at fault, or the case exists already.
        GapscopeError: the arm became unstable, or something cannot be written.
    """
    check_known("format", ending, list(ENDINGS), where="format")
    truth, faults = read_with_faults(effects)
    _check_places(effects, out, sealed)
    arm, known = read_arm_and_controller(robot)
    chosen = _chosen_controller(controller, arm, known)
    if sealed is not None:
        make_folder(sealed)
    rng = np.random.default_rng(seed)
    name = out.resolve().name

    def write_truth(folder: Path) -> None:
        write_corrected(name, truth, (sealed or folder) / TRUTH, faults=faults)

    with locked(out):
        with error_context(effects, truth):
            case = record_case(
                name, arm, truth, plan, rng, controller=chosen, progress=progress
            )
            case = _with_faults(case, faults, rng)
        progress("writes the case")
        # with its truth in it from the start: without, it could not be told from a sealed one
        file = write_case(case, out, ending=ending, beside=write_truth)
    hidden = hidden_by_reading_back(truth) if plan.read_back else ()
    note = (
        f"{', '.join(hidden)}: torque that is read back behind the drive hardly shows this; without --read-back the "
        "torque commanded is recorded"
    )
    return [file, (sealed or out) / TRUTH], note if hidden else None


def _with_faults(
    case: Case, faults: tuple[Fault, ...], rng: np.random.Generator
) -> Case:
    """The case as a set-up with these faults would have written it."""
    vendor = case.arm
    for fault in faults:
        case = fault.in_case(case, rng, vendor)
    return case


def _check_places(effects: Path, out: Path, sealed: Path | None) -> None:
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
    if (sealed / TRUTH).exists() and (sealed / TRUTH).resolve() != effects.resolve():
        raise InputError(
            "exists already and would be lost",
            "choose another folder",
            file=sealed / TRUTH,
        )


def _chosen_controller(
    controller: str | None, arm: NominalArm, known: Controller | None
) -> Controller | str:
    """The controller of a file, or the one known of a case; a control law for gains that fit the arm."""
    if controller is None:
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
    if known is not None and known.kind == controller:
        return known
    return controller
