"""Short cases for ``45_fleet_cost.py``: a known arm, a few motions, effects and seeds drawn for each case."""

from __future__ import annotations

from datetime import date, timedelta
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, Limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

ROBOT, RATE = "kuka_iiwa", 250.0
"""The arm, and samples per second [Hz]."""
SHORT, LONG = 6.0, 30.0
"""Lengths of a recording; a case has two of one length [s]. From both, cost per case and per second follow."""
SHARE_LONG = 0.1
"""Share of the cases that have long recordings [1]."""
NOISE = 0.05
"""Standard deviation of the torque's noise [N m]."""
FIRST_DAY = date(2026, 1, 1)
MOTIONS = 4
"""Motions that all cases share."""


def make_cases(folder: Path, units: int, days: int, seed: int) -> float:
    """Write a case for each unit and day; returns the length of all recordings [s]."""
    rng = np.random.default_rng(seed)
    arm = load_nominal_arm(ROBOT)
    body = RigidBody(arm)
    motions = [_motion(rng, arm, frequency) for frequency in (0.1, 0.15, 0.2, 0.3)]
    recorded = 0.0
    for unit in range(units):
        effects = _effects(rng, arm.n_joints)
        for day in range(days):
            length = LONG if rng.random() < SHARE_LONG else SHORT
            chosen = rng.choice(MOTIONS, 2, replace=False)
            recordings = tuple(
                _recording(f"{k}.csv", motions[m], length, (arm, body), effects, rng)
                for k, m in enumerate(chosen)
            )
            name = f"unit{unit:04d}_{FIRST_DAY + timedelta(days=day)}"
            place = folder / name
            write_case(Case(name, folder, arm, recordings), place)
            recorded += 2 * length
    return recorded


def _motion(rng: np.random.Generator, arm: NominalArm, frequency: float) -> Fourier:
    n = arm.n_joints
    limits = Limits(*(np.full(n, value) for value in (-1.5, 1.5, 1.5, 6.0)))
    return Fourier.random(rng, limits, duration=LONG, frequency=frequency)


def _effects(rng: np.random.Generator, n: int) -> tuple[AppliedEffect, ...]:
    """Friction on one or two joints, and on every other unit a load."""
    joints = tuple(sorted(int(j) + 1 for j in rng.choice(n, rng.integers(1, 3), False)))
    torque = rng.uniform(1.0, 4.0, len(joints))
    drawn = [AppliedEffect("coulomb_friction", joints, {"torque": torque})]
    if rng.random() < 0.5:
        load = {"mass": rng.uniform(0.5, 2.0), "com": [0.0, 0.0, 0.06]}
        drawn.append(AppliedEffect("payload", (), load))
    return tuple(drawn)


def _recording(
    name: str,
    motion: Fourier,
    length: float,
    arm_and_body: tuple[NominalArm, RigidBody],
    effects: tuple[AppliedEffect, ...],
    rng: np.random.Generator,
) -> Recording:
    arm, body = arm_and_body
    t = np.arange(int(length * RATE) + 1) / RATE
    seen = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
    tau = CorrectedArm(arm, effects).predict(body, seen)
    tau = tau + NOISE * rng.standard_normal(tau.shape)
    return Recording(name, t, seen.q, tau)
