"""What ``gapscope record`` checks before it works: places of case and truth, and the controller."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.control import LAWS
from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_controller
from gapscope.arm.io.write_case import is_used
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm

ENDINGS = ["csv", "parquet", "npz"]
"""Formats of the recordings."""
TRUTH = "truth.yaml"
"""File with the effects of a recorded case."""


def check_places(effects: Path, out: Path, sealed: Path | None) -> None:
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


def chosen_controller(
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
