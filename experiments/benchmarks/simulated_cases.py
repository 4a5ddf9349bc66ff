"""Simulated cases of any length, rate, number of joints and of effects, to measure against."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.benchmarks.chain_arm import chain_arm
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case

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
RINGING = (
    AppliedEffect("joint_elasticity", (2,), {"stiffness": [6000.0], "damping": [8.0]}),
    AppliedEffect("armature", (2,), {"inertia": [0.5]}),
)
"""What makes a joint of the KUKA ring: a compliance that the search has to simulate."""
FRICTION, LOAD = 2.0, 0.5
"""Friction of the first joint [N m] and mass at the tool [kg] of a chain."""


@dataclass(frozen=True)
class Simulated:
    """What a case holds.

    Attributes:
        seconds: of all recordings together.
        rate: [Hz].
        joints: of a chain of links; ``None``: the KUKA iiwa, which has seven.
        effects: how many of ``EFFECTS`` the KUKA has; a chain has two of its own.
        rings: whether the KUKA has ``RINGING`` as well.
    """

    seconds: float = 60.0
    rate: float = 500.0
    joints: int | None = None
    effects: int = 2
    rings: bool = False

    @property
    def name(self) -> str:
        """A name that says all of it."""
        joints = f"{self.n_joints} joint" + "s" * (self.n_joints > 1)
        arm = joints if self.joints is None else f"chain of {joints}"
        what = f"{self.effects} effects" if self.joints is None else "2 effects"
        name = f"{arm}, {self.seconds:g} s at {self.rate:g} Hz, {what}"
        return f"{name}, a joint rings" if self.rings else name

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.joints or IIWA_JOINTS

    @property
    def sizes(self) -> dict[str, float | str]:
        """Its sizes, for a row."""
        return {
            "arm": "KUKA iiwa" if self.joints is None else "chain",
            "joints": self.n_joints,
            "seconds": self.seconds,
            "rate_hz": self.rate,
            "effects": self.effects,
            "rings": str(self.rings),
        }


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
        return EFFECTS[: case.effects] + RINGING * case.rings
    friction = AppliedEffect("coulomb_friction", (1,), {"torque": [FRICTION]})
    load = AppliedEffect("payload", (), {"mass": LOAD, "com": [0.0, 0.0, 0.2]})
    return friction, load
