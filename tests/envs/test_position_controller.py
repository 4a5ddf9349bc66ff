"""The position controller: gains that hold along a whole motion, with a margin."""

from pathlib import Path

import numpy as np
import pytest
from arms import Link, changed, written
from sweeps import nightly

from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import ModelWarning
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.velocity_filter import filter_gains
from gapscope.envs.position_controller import (
    GAIN_MARGIN,
    LATE,
    RATE,
    VELOCITY_CUTOFF,
    VELOCITY_DAMPING,
    SampledLoop,
    loop_inertia,
    position_controller,
    stiffest_mode,
)
from gapscope.envs.recorder import Plan, record_case

pytestmark = pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")


def test_gains_hold_along_the_whole_motion() -> None:
    """On an arm without rotors no mode along the motion is stiffer than allowed, and no gain is raised."""
    arm = load_nominal_arm("franka_panda")
    body = RigidBody(arm)
    along = np.random.default_rng(0).uniform(*body.position_limits(), (100, 7))
    one = loop_inertia(arm, along[0], 4.0)
    whole = loop_inertia(arm, along[0], 4.0, along)
    loops = [np.linalg.solve(body.mass_matrix(q), np.diag(whole)) for q in along]
    stiffest = max(np.linalg.eigvals(loop).real[0] for loop in loops)
    assert stiffest <= stiffest_mode(4.0) * (1 + 1e-6)
    assert (whole <= one * (1 + 1e-9)).all() and whole.min() > 0


@pytest.mark.parametrize(
    ("robot", "seed"), [("franka_panda", 1), nightly("kuka_iiwa", 3)]
)
def test_healthy_arms_without_a_data_sheet_are_recorded(robot: str, seed: int) -> None:
    """Seeds that diverged with gains on the inertia of one posture."""
    rng = np.random.default_rng(seed)
    case = record_case(robot, load_nominal_arm(robot), (), Plan(), rng)
    errors = [np.abs(r.q_ref - r.q).max() for r in case.recordings]
    assert max(errors) < 0.01


LIGHT = Link("a", "upper", mass=0.05, com="0 0 0", inertia="1e-4 1e-4 1e-4")
HEAVY = Link("b", "lower", mass=1, com="0 0 0.15", inertia="2e-3 2e-3 1e-3")
"""Upright on two joints with one axis, a light link between them: without friction stiff gains ring."""


def _light_link(tmp_path: Path, damping: float) -> Recording:
    more = {"more": f'<dynamics damping="{damping}"/>', "limit": "-1 1 50 1"}
    links = changed((LIGHT, HEAVY), **more)
    arm = load_nominal_arm(written(tmp_path / "light.urdf", "light", *links))
    plan = Plan(recordings=1, engine="mujoco")
    case = record_case("light", arm, (), plan, np.random.default_rng(0))
    return case.recordings[0]


@pytest.mark.parametrize("damping", [0.3, 3.0])
def test_joints_in_stiff_grease_follow_and_hold_their_weight(
    tmp_path: Path, damping: float
) -> None:
    recording = _light_link(tmp_path, damping)
    assert np.abs(recording.q - recording.q_ref).max() < 2e-3


@pytest.mark.parametrize("robot", ["kuka_iiwa", "xarm6"])
def test_gains_against_friction_keep_their_margin(robot: str) -> None:
    """Arms whose files state friction and no rotors: stable at twice the gains, with a late torque, in all postures."""
    arm = load_nominal_arm(robot)
    body = RigidBody(arm)
    along = np.random.default_rng(0).uniform(-1.0, 1.0, (30, arm.n_joints))
    plain = (8 * np.pi) ** 2 * loop_inertia(arm, along[0], 4.0, along)
    pd = position_controller(arm, along[0], along=along)
    assert (pd.kp > 1.1 * plain).any()
    law = PD(rate=RATE, kp=GAIN_MARGIN * pd.kp, kd=GAIN_MARGIN * pd.kd)
    estimate = filter_gains(RATE, VELOCITY_CUTOFF, VELOCITY_DAMPING)
    loop = SampledLoop(law, 1 / RATE, estimate, LATE)
    assert all(loop.stable(body.mass_matrix(q), arm.viscous) for q in along)


def test_an_arm_that_falls_over_is_warned_of(tmp_path: Path) -> None:
    with pytest.warns(ModelWarning, match=r"did not hold joints 1 \(a\), 2 \(b\) off"):
        _light_link(tmp_path, damping=0.0)
