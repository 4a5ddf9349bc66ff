"""The arms of the tests: chains of joints written out here, and known robots with a data sheet.

``diagnosis/synthetic.py`` has an arm of its own: its simulator shares nothing with the package.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm


class Link(NamedTuple):
    """A link and the joint that moves it, in the words of a URDF.

    ``com`` is from the joint [m]; ``inertia`` about it, xx yy zz and perhaps xy xz yz [kg m^2]; ``limit`` is lower,
    upper, effort and velocity; ``more`` is text of the joint, ``shape`` of the link. The link before is the parent.
    """

    joint: str
    name: str
    axis: str = "0 1 0"
    origin: str = "0 0 0"
    mass: float = 2
    com: str = "0.5 0 0"
    inertia: str = "0.01 0.05 0.05"
    limit: str = "-3 3 99 9"
    kind: str = "revolute"
    rpy: str = "0 0 0"
    more: str = ""
    shape: str = ""


ROD = Link("hinge", "rod", limit="", kind="continuous")
"""2 kg at 0.5 m from a horizontal axis: 0.55 kg m^2 about it, gravity torque -9.81 cos q N m."""
YAW_PITCH = (
    Link("yaw", "upper", "0 0 1"),
    Link("pitch", "lower", origin="0.6 0 0.1"),
)
"""Two such rods, the first about a vertical axis."""


def changed(links: Iterable[Link], **fields: Any) -> tuple[Link, ...]:
    """The same links with other fields."""
    return tuple(link._replace(**fields) for link in links)


HEAVY = changed(YAW_PITCH, mass=4, com="0.3 0.02 0.01", inertia="0.02 0.1 0.1")
"""The same two with links of 4 kg that lie a little beside their axis."""


def urdf(name: str, *links: Link, base: str = '<link name="base"/>') -> str:
    """Text of the URDF of a chain."""
    parts, parent = [f'<robot name="{name}">{base}'], "base"
    for link in links:
        limit = ""
        if link.limit:
            values = zip(LIMIT, link.limit.split(), strict=True)
            limit = f"<limit {_attributes(values)}/>"
        moments = [*link.inertia.split(), "0", "0", "0"]
        inertia = _attributes(zip(INERTIA, moments, strict=False))
        parts.append(f"""
  <joint name="{link.joint}" type="{link.kind}">
    <parent link="{parent}"/><child link="{link.name}"/><origin xyz="{link.origin}" rpy="{link.rpy}"/>
    <axis xyz="{link.axis}"/>{limit}{link.more}
  </joint>
  <link name="{link.name}">
    <inertial><mass value="{link.mass}"/><origin xyz="{link.com}"/><inertia {inertia}/></inertial>{link.shape}
  </link>""")
        parent = link.name
    return "".join([*parts, "\n</robot>"])


LIMIT = ("lower", "upper", "effort", "velocity")
INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _attributes(values: Iterable[tuple[str, str]]) -> str:
    return " ".join(f'{key}="{value}"' for key, value in values)


def written(file: Path, name: str, *links: Link, **base: str) -> Path:
    """The URDF of a chain, written to a file."""
    file.write_text(urdf(name, *links, **base), encoding="utf-8")
    return file


def chain(
    folder: Path,
    name: str,
    *links: Link,
    base: str = '<link name="base"/>',
    **sheet: Any,
) -> NominalArm:
    """A chain with a data sheet, a list or an array for each quantity."""
    path = written(folder / f"{name}.urdf", name, *links, base=base)
    joints = tuple(link.joint for link in links)
    values = {key: np.array(value, dtype=float) for key, value in sheet.items()}
    return NominalArm(name, path, joints, **values)


def iiwa_of_three() -> NominalArm:
    """Three joints of the iiwa, with rotors and friction."""
    sheet = {
        "armature": [0.3, 0.3, 0.2],
        "viscous": [4.0, 4.0, 2.0],
        "coulomb": [1.0, 1.0, 0.5],
    }
    joints = [f"lbr_iiwa_joint_{j}" for j in (1, 2, 4)]
    return load_nominal_arm("kuka_iiwa", joints=joints, sheet=sheet)


FACTORS = {3: 0.3, 7: 6.0}
"""Links of ``tooled_panda`` whose mass and inertia are scaled: a light upper arm, whose mass an error soon makes
negative, and a tool."""


@cache
def tooled_panda() -> NominalArm:
    """A Panda with a light upper arm and a heavy tool, and with rotors and friction in its data sheet."""
    plain = load_nominal_arm("franka_panda")
    text = plain.urdf.read_text(encoding="utf-8")
    for link, factor in FACTORS.items():
        start = text.index("<inertial", text.index(f'<link name="panda_link{link}"'))
        end = text.index("</inertial>", start)
        parts = re.split(r'((?:mass value|i[xyz][xyz])=")([^"]+)', text[start:end])
        parts[2::3] = [str(float(number) * factor) for number in parts[2::3]]
        text = text[:start] + "".join(parts) + text[end:]
    path = Path(mkdtemp()) / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return replace(
        plain,
        urdf=path,
        armature=np.array([0.4, 0.4, 0.25, 0.25, 0.1, 0.08, 0.05]),
        coulomb=np.array([5.0, 5.0, 4.0, 4.0, 3.0, 2.0, 1.5]),
        viscous=np.array([4.0, 4.0, 3.0, 3.0, 2.0, 1.0, 0.8]),
    )
