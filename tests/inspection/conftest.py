"""A motion of an arm with the torque that it needs."""

from __future__ import annotations

import numpy as np
import pytest
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm


@pytest.fixture(scope="session")
def arm() -> NominalArm:
    return load_nominal_arm("kuka_iiwa")


@pytest.fixture(scope="session")
def motion(arm: NominalArm) -> Recording:
    """Six seconds at 200 Hz of a healthy arm with a little noise on the torque."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 6.0, 0.005)
    n = arm.n_joints
    phase, size = rng.uniform(0, 6, n), rng.uniform(0.4, 0.7, n)
    seen = sines(t, size, 1.5 + 0.3 * np.arange(n), phase)
    tau = RigidBody(arm).inverse_dynamics(seen.q, seen.dq, seen.ddq)
    tau += 0.05 * rng.standard_normal(tau.shape)
    return Recording("motion", t, seen.q, tau, seen.dq)
