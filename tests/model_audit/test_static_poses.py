"""Gravity torque of a model against torque at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.shifted_inertials import shifted_arm
from gapscope.model_audit.static_poses import check_static, static_poses

POSES, HELD, RATE = 16, 40, 50
"""Poses of a recording, samples of each, and their rate [Hz]."""


@pytest.fixture(scope="module")
def q() -> np.ndarray:
    """Random poses of seven joints [rad], shape (POSES, 7)."""
    return np.random.default_rng(3).uniform(-1.2, 1.2, (POSES, 7))


def recorded(folder: Path, q: np.ndarray, tau: np.ndarray) -> Path:
    """A file in which each pose is held for a moment, with noise on the torque."""
    rng = np.random.default_rng(1)
    positions, torques = (np.repeat(x, HELD, axis=0) for x in (q, tau))
    torques = torques + 0.05 * rng.standard_normal(torques.shape)
    t = np.arange(len(positions)) / RATE
    heads = ["t", *(f"{x}{j}" for x in ("q", "tau") for j in range(1, 8))]
    path = folder / "static.csv"
    table = np.column_stack([t, positions, torques])
    np.savetxt(path, table, delimiter=",", header=",".join(heads), comments="")
    return path


def gravity(arm, q: np.ndarray) -> np.ndarray:
    return RigidBody(arm).inverse_dynamics(q, 0 * q, 0 * q)


def test_the_right_model_agrees(tmp_path: Path, q: np.ndarray) -> None:
    tau = gravity(load_nominal_arm("kuka_iiwa"), q) + 0.3
    static = static_poses("kuka_iiwa", recorded(tmp_path, q, tau))
    assert static.poses == POSES and not list(check_static(static))
    assert static.correlation[1] > 0.999
    assert static.scale[1:5] == pytest.approx(np.ones(4), abs=0.03)
    assert static.offset[1] == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda tau: 0.8 * tau, "one scale of 0.8 on all joints"),
        (lambda tau: -tau, "torque of the opposite sign on all joints"),
        (lambda tau: tau * [1, 1, 1, -1, 1, 1, 1], "opposite sign on joint 4"),
        (lambda tau: 0 * tau + 0.1, "a torque column without gravity"),
    ],
)
def test_what_is_wrong_with_the_torque_is_said(
    tmp_path: Path, q: np.ndarray, change, said: str
) -> None:
    tau = change(gravity(load_nominal_arm("kuka_iiwa"), q))
    static = static_poses("kuka_iiwa", recorded(tmp_path, q, tau))
    assert said in static.explanations[0].name


def test_a_heavier_link_is_named(tmp_path: Path, q: np.ndarray) -> None:
    arm = load_nominal_arm("kuka_iiwa")
    more = np.zeros((7, 10))
    more[3, :4] = 2.0, 0.0, 0.2, 0.1
    tau = RigidBody(arm).changed(more).inverse_dynamics(q, 0 * q, 0 * q)
    static = static_poses("kuka_iiwa", recorded(tmp_path, q, tau))
    assert "link moved by joint 4" in static.explanations[0].name
    assert "link moved by joint 4" in next(check_static(static)).found


@pytest.mark.parametrize(("by", "word"), [(1, "next"), (-1, "previous")])
def test_shifted_inertials_are_told_by_gravity(
    tmp_path: Path, q: np.ndarray, by: int, word: str
) -> None:
    arm = load_nominal_arm("kuka_iiwa")
    wrong = shifted_arm(arm, by).urdf
    path = recorded(tmp_path, q, gravity(arm, q))
    best = static_poses(wrong, path).explanations[0]
    assert best.name == f"each link with the inertial of the {word} one"
    assert best.misfit < 0.02


def test_a_moving_recording_is_refused(tmp_path: Path) -> None:
    q = np.repeat(np.linspace(0, 3, 20 * HELD)[:, None], 7, axis=1)
    t = np.arange(len(q)) / RATE
    heads = ["t", *(f"{x}{j}" for x in ("q", "tau") for j in range(1, 8))]
    path = tmp_path / "moving.csv"
    table = np.column_stack([t, q, np.sin(q)])
    np.savetxt(path, table, delimiter=",", header=",".join(heads), comments="")
    with pytest.raises(InputError, match="rests in 0 poses"):
        static_poses("kuka_iiwa", path)
