"""The load that a robot was told to carry, by the columns of a log of a known layout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.link_shapes import read_frames
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.channel_entry import name_of
from gapscope.arm.io.layouts import LoadPlace, layout_of
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.inspection.inspected_table import InspectedTable


@dataclass(frozen=True)
class ToldLoad:
    """A load as a robot was told of it.

    Attributes:
        load: as a point, in the frame of the joint that moves the last link.
        why: which columns say so, and what is uncertain.
    """

    load: KnownLoad
    why: str


def told_load(table: InspectedTable, arm: NominalArm) -> ToldLoad | None:
    """The load that a table holds; ``None`` if it holds none, or one that changes, or of no mass."""
    layout = layout_of(table.part.table, table.part.kind)
    for place in () if layout is None else layout.loads:
        names = [place.mass, *(name_of(place.com, j, "") for j in range(3))]
        columns = table.part.table.columns
        if not all(name in columns for name in names):
            continue
        values = np.column_stack([columns[name] for name in names]).astype(float)
        mass, *centre = values[0]
        if mass > 0 and np.ptp(values, axis=0).max() == 0:
            return _placed(place, mass, np.array(centre), arm)
    return None


def _placed(
    place: LoadPlace, mass: float, centre: np.ndarray, arm: NominalArm
) -> ToldLoad:
    """The load in the frame of the last joint."""
    frames = read_frames(RigidBody(arm)).values()
    of_last = [frame for frame in frames if frame.joint == arm.joints[-1]]
    why = f"told to the robot ({place.mass}, {place.com})"
    for frame in of_last:
        if frame.name.endswith(place.frames):
            centre = frame.position + frame.rotation @ centre
            why += f", its centre in the frame of {frame.name}"
            break
    else:
        why += ", its centre in the flange's frame, which the robot file does not have: correct com"
    x, y, z = (round(float(value), 6) for value in centre)
    return ToldLoad(KnownLoad(float(mass), (x, y, z)), why)
