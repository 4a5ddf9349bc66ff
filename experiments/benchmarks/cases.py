"""Cases to measure against: simulated ones of any size, and sample cases and real arms from GAPSCOPE_DATA."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case

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


IIWA_JOINTS = 7
RECORDINGS = 3
"""That a case's time is divided into, from slow to fast."""
SLOWEST_CONTROLLER = 1000.0
"""Rate of the controller [Hz], at least."""
ENCODER_NOISE = 2e-5
"""[rad]"""
EFFECTS = (
    AppliedEffect("coulomb_friction", (2, 4), {"torque": [4.0, 2.0]}),
    AppliedEffect("payload", (), {"mass": 1.0, "com": [0.0, 0.0, 0.08]}),
    AppliedEffect("viscous_friction", (1, 3), {"coefficient": [4.0, 3.0]}),
    AppliedEffect("armature", (5,), {"inertia": [0.3]}),
    AppliedEffect("torque_offset", (6,), {"torque": [1.5]}),
    AppliedEffect("parallel_spring", (2,), {"stiffness": [15.0], "rest": [0.0]}),
    AppliedEffect("torque_scale", (4,), {"scale": [0.8]}),
    AppliedEffect("actuator_delay", (1,), {"delay": [0.01]}),
)
"""What the KUKA iiwa has beyond its model, of which a case takes the first ones."""
FRICTION, LOAD = 2.0, 0.5
"""Friction of the first joint [N m] and mass at the tool [kg] of a chain."""


class Simulated(NamedTuple):
    """What a case holds.

    Attributes:
        seconds: of all recordings together.
        rate: [Hz].
        joints: of a chain of links; ``None``: the KUKA iiwa, which has seven.
        effects: how many of ``EFFECTS`` the KUKA has; a chain has two of its own.
    """

    seconds: float = 60.0
    rate: float = 500.0
    joints: int | None = None
    effects: int = 2

    @property
    def name(self) -> str:
        """A name that says all of it."""
        joints = f"{self.n_joints} joint" + "s" * (self.n_joints > 1)
        arm = joints if self.joints is None else f"chain of {joints}"
        what = f"{self.effects} effects" if self.joints is None else "2 effects"
        return f"{arm}, {self.seconds:g} s at {self.rate:g} Hz, {what}"

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.joints or IIWA_JOINTS


def simulated_case(case: Simulated, folder: Path) -> Path:
    """The case in a folder of its own, recorded if it is not there yet."""
    place = folder / case.name.replace(",", "").replace(" ", "_")
    if (place / "case.yaml").is_file():
        return place
    rng = np.random.default_rng(1)
    arm = (
        load_nominal_arm("kuka_iiwa")
        if case.joints is None
        else chain_arm(case.joints, folder)
    )
    # the controller's rate is a multiple of the recording's
    every = max(1, math.ceil(SLOWEST_CONTROLLER / case.rate))
    pd = position_controller(arm, workspace(RigidBody(arm)).posture)
    plan = Plan(
        recordings=RECORDINGS,
        duration=case.seconds / RECORDINGS,
        rate=case.rate,
        encoder_noise=ENCODER_NOISE,
    )
    with threadpool_limits(1):
        recorded = record_case(
            place.name,
            arm,
            _effects(case, arm),
            plan,
            rng,
            controller=replace(pd, rate=every * case.rate),
        )
    write_case(recorded, place, ending="npz")
    return place


def _effects(case: Simulated, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    if case.joints is None:
        return EFFECTS[: case.effects]
    friction = AppliedEffect("coulomb_friction", (1,), {"torque": [FRICTION]})
    load = AppliedEffect("payload", (), {"mass": LOAD, "com": [0.0, 0.0, 0.2]})
    return friction, load


CASES = Path(__file__).parents[1] / "cases"
REAL = (
    "kinova_gen3_current",
    "kuka_med7",
    "panda",
    "staubli_tx40",
    "unitree_z1",
    "ur10",
)
"""Real arms, each with its file in ``experiments/cases``."""


class Measured(NamedTuple):
    """A case, and a reference if it is diagnosed against one."""

    name: str
    case: Path
    reference: Path | None = None


def data_folder() -> Path | None:
    """The folder of the recordings, if there is one."""
    folder = Path(os.environ.get("GAPSCOPE_DATA", ""))
    return folder if "GAPSCOPE_DATA" in os.environ and folder.is_dir() else None


def sample_cases() -> list[Measured]:
    """Cases from a simulator that shares no code with the project."""
    data = data_folder()
    folders = sorted((data / "sample_cases").glob("case*")) if data else []
    return [Measured(folder.name, folder) for folder in folders]


def real_cases() -> list[Measured]:
    """The real arms whose recordings are there."""
    if data_folder() is None:
        return []
    return [Measured(name, CASES / f"{name}.yaml") for name in REAL]
