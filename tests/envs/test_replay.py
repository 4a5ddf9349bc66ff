"""Replay: what a recording was made with closes its gap, with and without the controller."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import swinging
from sweeps import daily

from gapscope.arm.case import load_case
from gapscope.arm.control import PD
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import RULES, VelocityFilter, rule_of
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.envs.replay import HORIZON, TRIM, replay

EFFECTS = (
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.05]}),
    AppliedEffect("actuator_delay", (2, 4), {"delay": 0.005}),
)


@pytest.fixture(scope="module")
def controller(data_sheet_arm: NominalArm) -> Controller:
    return position_controller(data_sheet_arm, POSTURE)


@pytest.fixture(scope="module")
def recording(data_sheet_arm: NominalArm, controller: Controller) -> Recording:
    """Three seconds of a smooth motion of the arm with effects."""
    arm, (motion_rng, rng) = data_sheet_arm, map(np.random.default_rng, (0, 0))
    motion = swinging(arm, motion_rng, POSTURE, duration=3.0, frequency=0.4)
    return record(arm, EFFECTS, motion, controller, duration=3.0, rng=rng)


def test_same_effects_close_the_gap(
    data_sheet_arm: NominalArm, controller: Controller, recording: Recording
) -> None:
    several = ((), EFFECTS)
    nominal, same = (replay(data_sheet_arm, x, recording, controller) for x in several)
    assert same.through_controller
    assert same.q.shape == same.tau.shape == recording.q.shape
    assert nominal.rmse.max() > 1e-2 and same.rmse.max() < 1e-4, same.rmse
    inner = (recording.t >= TRIM) & (recording.t <= recording.t[-1] - TRIM)
    assert np.abs(same.tau - recording.tau)[inner].max() < 1.0


def test_a_known_payload_is_one_more(
    data_sheet_arm: NominalArm, controller: Controller, recording: Recording
) -> None:
    """Beside a payload found as alone: the sum of both is simulated; the controller believes in neither."""
    load = KnownLoad(2.0, (0.0, 0.0, 0.05))
    loaded = replace(recording, payload=load)
    carried = replay(data_sheet_arm, EFFECTS[1:], loaded, controller)
    assert carried.rmse.max() < 1e-4
    half = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.0, 0.0, 0.05]})
    rest = replace(recording, payload=KnownLoad(1.0, load.com))
    both = replay(data_sheet_arm, (half, *EFFECTS[1:]), rest, controller)
    np.testing.assert_allclose(both.q, carried.q, atol=1e-9)


def test_without_the_controller_the_recorded_torque_moves_the_arm(
    data_sheet_arm: NominalArm, recording: Recording
) -> None:
    several = ((), EFFECTS)
    nominal, same = (replay(data_sheet_arm, x, recording, None) for x in several)
    assert not same.through_controller
    np.testing.assert_array_equal(same.tau, recording.tau)
    assert (same.rmse < 2e-3).all(), same.rmse
    assert same.rmse.mean() < 0.3 * nominal.rmse.mean()
    # each horizon starts where the arm was measured
    first = np.arange(0, len(recording.t), round(HORIZON * recording.rate))
    assert np.abs(same.q - recording.q)[first].max() < 1e-3


def test_reference_without_a_controller_that_is_known_is_no_command(
    data_sheet_arm: NominalArm, recording: Recording
) -> None:
    with pytest.raises(InputError, match="no torque"):
        replay(data_sheet_arm, (), replace(recording, tau=None), None)


def test_replay_starts_anew_behind_a_gap(
    data_sheet_arm: NominalArm, controller: Controller, recording: Recording
) -> None:
    cut = recording.part((recording.t < 1.0) | (recording.t > 1.5))
    found = replay(data_sheet_arm, EFFECTS, cut, controller)
    behind = int((recording.t < 1.0).sum())
    np.testing.assert_allclose(found.q[behind], cut.q[behind], atol=1e-4)
    assert found.rmse.max() < 1e-2


def test_an_arm_that_runs_away_is_reported(
    data_sheet_arm: NominalArm, recording: Recording
) -> None:
    arm = replace(data_sheet_arm, torque_limit=None)
    with pytest.raises(GapscopeError, match="diverged"):
        replay(arm, (), recording, PD(rate=1000.0, kp=np.full(7, 1e7), kd=np.zeros(7)))


@pytest.mark.parametrize(
    ("rate", "rule"),
    # at 500 Hz and 80 Hz the semi-implicit rule diverges
    [*((1000.0, rule) for rule in RULES), (500.0, "bilinear"), (500.0, "backward")],
)
def test_filter_rule_shows_in_a_recorded_velocity(rate: float, rule: str) -> None:
    t = np.arange(0.0, 4.0, 1 / rate)
    q, one = 0.5 * np.sin(3 * np.pi * t)[:, None], np.ones(1)
    filtered = VelocityFilter((rate, 80.0, 0.9), q[0], 1.5 * np.pi * one, rule)
    dq = np.array([filtered(row) for row in q])
    filters = {"velocity_cutoff": 80.0, "velocity_damping": 0.9}
    law = PD(rate=rate, kp=one, kd=one, **filters)
    every = round(rate / 250.0)
    assert rule_of(Recording("r", t[::every], q[::every], dq=dq[::every]), law) == rule


SAMPLES = [f"case00{i}" for i in (0, 1, 2, 3, 4, 5, 7)]


def _labelled(
    sample_cases: Path, name: str, arm: NominalArm
) -> tuple[AppliedEffect, ...]:
    """Effects of a sample case's label; an elastic joint's damper from its damping ratio of 0.05.

    d = 2 zeta sqrt(k J), J the rotor's and the straight arm's inertia in series [N m s/rad].
    """
    labels = json.loads((sample_cases / "labels.json").read_text())
    effects, inertia = [], np.diag(RigidBody(arm).mass_matrix(np.zeros(arm.n_joints)))
    for effect in next(x["effects"] for x in labels if x["case"] == name):
        joints = tuple(effect["joints"])
        values = {key: x["value"] for key, x in effect["parameters"].items()}
        if effect["effect"] == "joint_elasticity":
            place = np.array(joints) - 1
            series = 1 / (1 / inertia[place] + 1 / arm.armature[place])
            values["damping"] = 0.1 * np.sqrt(np.array(values["stiffness"]) * series)
        effects.append(AppliedEffect(effect["effect"], joints, values))
    return tuple(effects)


@pytest.mark.shared_data
@pytest.mark.parametrize("name", daily(SAMPLES, "case001", "case005"))
@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_labelled_effects_close_a_case_of_another_simulator(
    engines, engine: str, name: str, sample_cases: Path
) -> None:
    """By at least 80 %, the mean over the joints; LuGre friction, noise and another integrator are what is left."""
    case = load_case(sample_cases / name, read_recordings=False)
    recording = load_recording(sample_cases / name / "recording_d.csv", case.arm, None)
    truth = _labelled(sample_cases, name, case.arm)
    before, after = (
        replay(case.arm, e, recording, case.controller, engine=engines(engine))
        for e in ((), truth)
    )
    assert after.rmse.mean() < 0.2 * before.rmse.mean(), (before.rmse, after.rmse)
