"""Serial arms of any number of joints, so that a cost can be measured against it."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm

LENGTH = 0.2
"""Of a link [m]."""
HEAVIEST, LIGHTER = 5.0, 0.85
"""Mass of the first link [kg], and of each over the one before [1]."""
RADIUS = 0.06
"""Of the links, which are full cylinders [m]."""

LINK = """
  <link name="link_{i}"><inertial><origin xyz="0 0 {middle}"/><mass value="{mass:.6g}"/>
    <inertia ixx="{across:.6g}" iyy="{across:.6g}" izz="{along:.6g}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint_{i}" type="revolute"><parent link="link_{before}"/><child link="link_{i}"/>
    <origin xyz="0 0 {offset}"/><axis xyz="{axis}"/>
    <limit lower="-2.5" upper="2.5" effort="500" velocity="3"/></joint>"""


def chain_arm(joints: int, folder: Path) -> NominalArm:
    """An arm of ``joints`` links that get lighter towards the tool, its axes across and along the links by turns."""
    links = "".join(_link(i) for i in range(1, joints + 1))
    urdf = folder / f"chain_{joints}.urdf"
    with atomic_write(urdf) as aside:
        aside.write_text(
            f'<robot name="chain_{joints}"><link name="link_0"/>{links}\n</robot>\n',
            encoding="utf-8",
        )
    return load_nominal_arm(urdf)


def _link(i: int) -> str:
    mass = HEAVIEST * LIGHTER ** (i - 1)
    return LINK.format(
        i=i,
        before=i - 1,
        mass=mass,
        middle=LENGTH / 2,
        across=mass * (3 * RADIUS**2 + LENGTH**2) / 12,
        along=mass * RADIUS**2 / 2,
        offset=LENGTH if i > 1 else 0.0,
        axis="0 1 0" if i % 2 else "0 0 1",
    )
