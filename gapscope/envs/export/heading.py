"""The comment at the head of an exported file: origin, gravity, meshes, and what the file leaves out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from gapscope.envs.export.left_out import left_out, remarks
from gapscope.envs.export.plain_arm import PlainArm


def heading(arm: PlainArm, form: str, more: tuple[str, ...], relative: bool) -> str:
    """Text of the comment.

    Args:
        arm: the arm.
        form: the format.
        more: what the writer of the format has to say beyond what is left out.
        relative: whether meshes are named from the folder of the file.
    """
    lines = [
        f"Corrected arm of {arm.body.file.name}, written by gapscope export; SI units. {effects_line(arm)}",
        f"Simulate it under gravity of {arm.gravity:g} m/s^2 along -z of the world"
        + (", as the base is turned into it." if not arm.upright else "."),
        f"Meshes are named by paths {'from the folder of this file' if relative else 'from the root of the disk'}.",
    ]
    missing = [*left_out(arm, form), *more]
    lines += (
        ["Left out:", *(f"  {line}" for line in missing)]
        if missing
        else ["Nothing is left out."]
    )
    if odd := remarks(arm):
        lines += [
            "Odd, and some simulators change such inertias:",
            *(f"  {line}" for line in odd),
        ]
    return xml_comment(lines)


def effects_line(arm: PlainArm) -> str:
    """Which effects an exported arm has."""
    names = ", ".join(dict.fromkeys(e.name for e in arm.corrected.effects))
    return f"Effects: {names or 'none'}."


def xml_comment(lines: Sequence[str]) -> str:
    """Lines as the text of a comment of XML."""
    text = "\n".join(lines)
    while "--" in text:  # which it may not hold
        text = text.replace("--", "- -")
    return f"\n{text}\n"


def mesh_path(mesh: Path, out: Path, relative: bool) -> str:
    """How a file ``out`` names a mesh: from its own folder, or absolutely."""
    if not relative:
        return mesh.resolve().as_posix()
    return Path(os.path.relpath(mesh.resolve(), out.resolve().parent)).as_posix()
