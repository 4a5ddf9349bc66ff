"""A corrected arm written as a file for another simulator."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.plain_urdf import rotation
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.nearest_name import check_known
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.export.mjcf import as_mjcf
from gapscope.envs.export.plain_arm import PlainArm, mesh_path, plain_arm
from gapscope.envs.export.snippets import TARGETS, drawing, write_snippet
from gapscope.envs.export.texts import FORMATS, heading, left_out, remarks, rendered
from gapscope.envs.export.urdf import as_urdf


def as_sdf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as SDF 1.6, a model of moving bodies on a base that is fixed to the world, and what else is left out.

    Poses of links are those of all joints at zero, in the world, in which the base is turned as it stands; axes are in
    the frames of the links that they move. Links that are fixed to another are merged into it. Arguments as those of
    ``as_mjcf``.
    """
    places = {"": (np.zeros(3), arm.mount)}
    tensors = {}
    for link in arm.links:
        position, turn = places[link.parent]
        place = position + turn @ link.origin[0], turn @ rotation(link.origin)
        places[link.joint] = place
        axes = rotation(link.inertial)
        tensors[link.joint] = axes @ np.diag(link.moments) @ axes.T
    text = rendered(
        "sdf.xml.j2",
        arm=arm,
        places=places,
        tensors=tensors,
        level=np.eye(3),
        mesh_path=lambda mesh: mesh_path(mesh, out, relative),
    )
    merged = [f.name for f in arm.frames.values() if f.name != arm.body_name(f.joint)]
    note = f"frames of {', '.join(merged)}: merged into the links that carry them"
    return text, (note,) * bool(merged)


WRITERS = {"urdf": as_urdf, "mjcf": as_mjcf, "sdf": as_sdf}
"""Writers of whole arms by format."""
ALL_FORMATS = (*FORMATS, *TARGETS)
"""Formats of whole arms, and those of snippets."""


def export(
    corrected: CorrectedArm,
    form: str,
    out: Path,
    *,
    relative: bool = False,
    controller: Controller | None = None,
    ranges: EffectRanges | None = None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write a corrected arm; ``out`` never holds half of it.

    Args:
        corrected: the arm with its effects.
        form: one of ``ALL_FORMATS``.
        out: the file.
        relative: name meshes from the folder of ``out``, not absolutely; whole arms alone have meshes.
        controller: of the case, whose gains a snippet may hold.
        ranges: what a snippet lets draw, or ``None``.

    Returns:
        What the file leaves out, and what is odd about the bodies; a sentence each. Both are in the file too.

    Raises:
        InputError: no such format, an effect on a joint that does not exist, friction or armature that is negative in
            total, bodies that no torque can move, or ranges for a format that has none.
        GapscopeError: the file cannot be written.
    """
    check_known("format", form, ALL_FORMATS, where="format")
    if form not in TARGETS and ranges is not None:
        raise InputError(
            f"a file of {form} has no ranges",
            f"leave it out, or choose one of {', '.join(drawing())}",
            where="--randomise",
        )
    arm = plain_arm(corrected)
    if form in TARGETS:
        return write_snippet(arm, form, out, controller, ranges), remarks(arm)
    written, more = WRITERS[form](arm, out, relative)
    comments = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    root = ET.fromstring(written, parser=comments)
    for element in root.iter():
        if not (element.text or "").strip():
            element.text = None
    ET.indent(root)
    comment = ET.tostring(
        ET.Comment(heading(arm, form, more, relative)), encoding="unicode"
    )
    text = f'<?xml version="1.0" encoding="utf-8"?>\n{comment}\n{ET.tostring(root, encoding="unicode")}\n'
    with atomic_write(out) as aside:
        aside.write_text(text, encoding="utf-8")
    return (*left_out(arm, form), *more), remarks(arm)
