"""The corrected arm for other simulators: files in, a file out."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.corrected_file import error_context, read_corrected_arm
from gapscope.envs.export.formats import export
from gapscope.envs.export.left_out import FORMATS


def export_file(
    corrected: Path,
    case: Path | None,
    robot: str | None,
    form: str,
    out: Path,
    relative: bool,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write the arm of a ``corrected.yaml`` as URDF, MJCF or SDF.

    Args:
        corrected: the file with the effects.
        case: the case whose nominal arm they add to, or ``None``.
        robot: a name, URDF or case in its place, or ``None``; one of both has to be given.
        form: the format.
        out: the file to write.
        relative: name meshes from the folder of ``out``.

    Returns:
        What is left out, and what is odd; see ``gapscope.envs.export.formats.export``.

    Raises:
        InputError: an argument or a file is at fault.
        GapscopeError: the file cannot be written.
    """
    check_known("format", form, FORMATS, where="--format")
    if (case is None) == (robot is None):
        raise InputError(
            "expected one of --case and --robot",
            "give the case that was diagnosed, with its data sheet; or a robot without one",
            where="--case",
        )
    arm = nominal_arm(str(case) if case is not None else str(robot))
    if out.exists() and out.resolve() in (corrected.resolve(), arm.urdf.resolve()):
        raise InputError(
            "would be overwritten", "choose another file with --out", file=out
        )
    found = read_corrected_arm(arm, corrected)
    with error_context(corrected, found.effects):
        return export(found, form, out, relative=relative)


def nominal_arm(robot: str) -> NominalArm:
    """The nominal arm of a name or URDF, or of a case.

    Raises:
        InputError: it cannot be used.
    """
    path = Path(robot)
    if path.suffix in (".yaml", ".yml") or path.is_dir():
        return load_case(path, read_recordings=False).arm
    return load_nominal_arm(robot)
