"""A plausible arm of boxes as URDF, whose file tests spoil."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

LENGTHS = (0.15, 0.4, 0.35, 0.2, 0.12, 0.1)
"""Of the links [m]."""
WIDTHS = (0.14, 0.12, 0.1, 0.09, 0.08, 0.07)
DENSITIES = (2000.0, 1500.0, 1800.0, 2200.0, 1700.0, 2500.0)


def link(number: int, shapes: bool) -> str:
    """A link along x or z in turn, homogeneous."""
    length, width = LENGTHS[number], WIDTHS[number]
    edges = np.array([width, width, width])
    along = 0 if number % 2 else 2
    edges[along] = length
    mass = DENSITIES[number] * edges.prod()
    moments = mass / 12 * ((edges**2).sum() - edges**2)
    centre = np.zeros(3)
    centre[along] = length / 2
    origin = f'<origin xyz="{centre[0]:.4f} {centre[1]:.4f} {centre[2]:.4f}"/>'
    size = " ".join(f"{edge:.4f}" for edge in edges)
    shape = f'<collision>{origin}<geometry><box size="{size}"/></geometry></collision>'
    return f"""  <link name="link_{number}">
    <inertial>
      {origin}
      <mass value="{mass:.4f}"/>
      <inertia ixx="{moments[0]:.6f}" ixy="0" ixz="0" iyy="{moments[1]:.6f}" iyz="0" izz="{moments[2]:.6f}"/>
    </inertial>
    {shape if shapes else ""}
  </link>"""


def joint(number: int) -> str:
    """The joint that moves a link, at the end of the one before."""
    before = number - 1
    place = [0.0, 0.0, 0.0]
    if number:
        place[0 if before % 2 else 2] = LENGTHS[before]
    parent = f"link_{before}" if number else "base"
    xyz = " ".join(f"{x:.4f}" for x in place)
    return f"""  <joint name="joint_{number + 1}" type="revolute">
    <parent link="{parent}"/>
    <child link="link_{number}"/>
    <origin xyz="{xyz}"/>
    <axis xyz="0 {number % 2} {1 - number % 2}"/>
    <limit lower="-2" upper="2" effort="{100 - 10 * number}" velocity="{2 + number}"/>
    <dynamics damping="{3 - 0.3 * number:.1f}" friction="{5 - 0.5 * number:.1f}"/>
  </joint>"""


@pytest.fixture
def arm_text() -> Callable[..., str]:
    """Text of the URDF, with shapes or without."""

    def text(shapes: bool = True) -> str:
        parts = [f"{joint(k)}\n{link(k, shapes)}" for k in range(len(LENGTHS))]
        return "\n".join(
            ['<robot name="boxes">', '  <link name="base"/>', *parts, "</robot>"]
        )

    return text


@pytest.fixture
def file_of(tmp_path: Path) -> Callable[[str], Path]:
    """Write text as a URDF file."""

    def write(text: str) -> Path:
        path = tmp_path / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    return write
