"""The nominal arm with the inertials of its URDF moved to other links."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from gapscope.arm.nominal import NominalArm
from gapscope.effects.setup_faults.inertial_fault import ShiftedInertials


def shifted_arm(arm: NominalArm, links: int, moved_only: bool = False) -> NominalArm:
    """The arm with each ``<inertial>`` moved ``links`` further among the links that have one, in file order.

    With ``moved_only`` among those of them that a joint moves. The new URDF lies in a temporary folder that lasts as
    long as the process. An MJCF file is left as it is.
    """
    if links == 0 or ET.parse(arm.urdf).getroot().tag != "robot":
        return arm
    path = Path(_folder(arm.urdf.resolve(), links, moved_only).name) / arm.urdf.name
    return replace(arm, urdf=path)


@cache
def _folder(urdf: Path, links: int, moved_only: bool) -> TemporaryDirectory[str]:
    """Temporary folder with the changed URDF."""
    folder: TemporaryDirectory[str] = TemporaryDirectory(prefix="gapscope-")
    text = ShiftedInertials(links, moved_only).urdf(urdf.read_text(encoding="utf-8"))
    (Path(folder.name) / urdf.name).write_text(text, encoding="utf-8")
    return folder
