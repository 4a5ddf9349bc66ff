"""A case of two joints whose motion, columns and data sheet tests spoil."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import Link, written

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.robots import load_nominal_arm

LINKS = (
    Link(
        *("pitch", "upper"),
        mass=4,
        com="0.3 0.02 0.01",
        inertia="0.01 0.1 0.1",
        limit="-3 3 90 9",
    ),
    Link(
        *("elbow", "lower"),
        origin="0.6 0 0",
        com="0.2 0.01 0.01",
        inertia="0.005 0.03 0.03",
        limit="-3 3 40 9",
    ),
)
Motion = Callable[[np.ndarray], np.ndarray]


def swinging(t: np.ndarray, phase: float = 0.0) -> np.ndarray:
    """Two joints to and fro, slowly and fast [rad], shape (N, 2)."""
    fast, slow = np.sin(3.1 * t + phase), np.sin(0.7 * t + phase)
    return np.column_stack([fast + 0.6 * slow, 0.8 * np.sin(2.3 * t) + 0.7 * slow])


@pytest.fixture
def make_case(tmp_path: Path) -> Callable[..., Path]:
    """Write a case: motions, and what is done to the tables and to the case file."""

    def make(
        motions: tuple[Motion, ...] = (swinging, lambda t: swinging(1.3 * t, 1.0)),
        spoil: Callable[[dict[str, np.ndarray]], None] = lambda table: None,
        **changed: object,
    ) -> Path:
        written(tmp_path / "robot.urdf", "two", *LINKS)
        sheet = {
            "armature": [0.3, 0.1],
            "coulomb": [2.0, 1.0],
            "viscous": [1.0, 0.5],
            "torque_limit": [90, 40],
        }
        arm = load_nominal_arm(tmp_path / "robot.urdf", sheet=sheet)
        body, names = RigidBody(arm), []
        for number, motion in enumerate(motions):
            t = np.arange(0, 12, 0.004)
            q = motion(t)
            dq = np.gradient(q, t, axis=0)
            ddq = np.gradient(dq, t, axis=0)
            tau = body.inverse_dynamics(q, dq, ddq) + arm.armature * ddq
            tau += arm.friction(dq) + 0.05 * np.random.default_rng(
                number
            ).standard_normal(tau.shape)
            # a reference that is no copy
            table = numbered({"t": t, "q": q, "dq": dq, "q_ref": q + 1e-6, "tau": tau})
            spoil(table)
            names.append(f"recording_{number}.csv")
            write_columns(table, tmp_path / names[-1])
        content = {
            "name": "two",
            "robot": "robot.urdf",
            "nominal": sheet,
            "controller": {"rate": 250, "kp": [100, 50], "kd": [10, 5]},
            "recordings": names,
            **changed,
        }
        kept = {key: value for key, value in content.items() if value is not None}
        (tmp_path / "case.yaml").write_text(yaml.safe_dump(kept))
        return tmp_path

    return make
