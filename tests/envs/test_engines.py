"""The engines against inverse dynamics, against each other, and against the conservation of energy."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from cases import swinging
from episodes import missing_torque
from guard import HANG
from sweeps import daily

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import ENGINES, check_engine
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.envs.simulated_arm import SimulatedArm

ROBOTS = ("kuka_iiwa", "franka_panda", "xarm6")
BACKWARDS = "kuka_iiwa backwards"
DROP = {"torque": [2.0, 1.5], "velocity": [0.1, 0.1]}
EFFECTS = (
    AppliedEffect("stribeck_friction", (2, 4), DROP),
    AppliedEffect("load_friction", (3,), {"coefficient": [0.15]}),
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.03, -0.02, 0.08]}),
    AppliedEffect("actuator_delay", (1, 4), {"delay": [0.0083, 0.002]}),
    AppliedEffect("base_tilt", (), {"roll": 0.04, "pitch": -0.03}),
)


@pytest.mark.parametrize("robot", daily((*ROBOTS, BACKWARDS), "kuka_iiwa", BACKWARDS))
@pytest.mark.parametrize("engine", ENGINES)
def test_without_effects_it_is_pinocchios_inverse_dynamics(
    engines, engine: str, robot: str
) -> None:
    """Torque to acceleration and back at random states, relative to the torque: 1e-8."""
    arm = load_nominal_arm(robot.split()[0])
    # five of the seven joints: the others are locked and their mass stays
    joints = arm.joints[4::-1] if robot == BACKWARDS else arm.joints
    arm = NominalArm("bare", arm.urdf, joints)
    body, rng, n = RigidBody(arm), np.random.default_rng(1), len(joints)
    low, high = (np.clip(limit, -2.0, 2.0) for limit in body.position_limits())
    with SimulatedArm(arm, engine=engines(engine)) as simulated:
        for _ in range(30):
            q = low + rng.uniform(0.1, 0.9, n) * (high - low)
            dq, wanted = rng.uniform(-2, 2, n), rng.uniform(-50, 50, n)
            torque = body.inverse_dynamics(q[None], dq[None], wanted[None])[0]
            off = missing_torque(simulated, q, dq, torque)
            assert np.abs(off).max() < 1e-8 * np.abs(torque).max()


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["off", "on"])
def test_same_case_gives_the_same_motion(
    engines, data_sheet_arm: NominalArm, effects: tuple
) -> None:
    """Joint RMSE against PyBullet far below the 1e-3 rad that a step of 1 ms might excuse."""
    arm, law = data_sheet_arm, position_controller(data_sheet_arm, POSTURE)
    start = np.random.default_rng(1)
    motion = swinging(arm, start, POSTURE, duration=3.0, frequency=0.3)
    how = {"duration": 3.0, "encoder_step": 0.0}
    first, second = (
        record(arm, effects, motion, law, rng=start, engine=engines(name), **how).q
        for name in ENGINES
    )
    assert np.sqrt(np.mean((first - second) ** 2, axis=0)).max() < 1e-6


@pytest.mark.parametrize("engine", ENGINES)
def test_free_swing_keeps_its_energy(
    engines, bare_arm: NominalArm, tmp_path: Path, engine: str
) -> None:
    """Hanging, 10 s: what the total energy strays and drifts, over the greatest kinetic one; both halve with the step.

    Joints have no limits, since the wrist swings past them. From twice as far the swing is chaotic.
    """
    free, text = tmp_path / "free.urdf", bare_arm.urdf.read_text()
    free.write_text(text.replace('type="revolute"', 'type="continuous"'))
    hanging = replace(bare_arm, urdf=free, gravity=np.array([0.0, 0.0, 9.81]))
    drift = []
    for dt in (1e-3, 5e-4):
        with SimulatedArm(hanging, (), dt, engine=engines(engine)) as simulated:
            simulated.reset(0.5 * np.array([0.15, 0.2, 0.1, -0.25, 0.05, 0.2, 0.0]))
            model, kinetic, total = simulated.body.model, [], []
            data = model.createData()
            for _ in range(round(10.0 / dt)):
                state = model, data, simulated.q
                kinetic.append(pin.computeKineticEnergy(*state, simulated.dq))
                total.append(kinetic[-1] + pin.computePotentialEnergy(*state))
                simulated.step(np.zeros(7))
        strayed = np.array([np.ptp(total), abs(total[-1] - total[0])])
        drift.append(strayed / max(kinetic))
    assert (drift[0] < [0.006, 0.004]).all() and (drift[1] < 0.51 * drift[0]).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_joint_limits_hold_under_gravity(
    engines, bare_arm: NominalArm, engine: str, friction: float
) -> None:
    arm = replace(bare_arm, coulomb=np.full(7, friction), viscous=np.full(7, 0.2))
    _, upper = RigidBody(arm).position_limits()
    with SimulatedArm(arm, engine=engines(engine)) as simulated:
        simulated.reset(np.array([0.0, 0.4, 0.0, 0.3, 0.0, 0.3, 0.0]))
        beyond = []
        for _ in range(300):
            simulated.step(np.zeros(7), 10)
            beyond.append((np.abs(simulated.q) - upper).max())
    assert -0.01 < max(0.0, *beyond) < 0.03


@pytest.mark.parametrize("engine", ENGINES)
def test_an_arm_that_diverges_is_seen_to_do_so(
    engines, bare_arm: NominalArm, engine: str, tmp_path: Path, monkeypatch
) -> None:
    """No engine puts it back where it started, and none writes a file about it."""
    monkeypatch.chdir(tmp_path)
    with SimulatedArm(bare_arm, engine=engines(engine)) as simulated:
        for _ in range(20):
            simulated.step(np.full(7, 1e6), 10)
        assert not np.abs(simulated.dq).max() < 50
    assert not list(tmp_path.iterdir())


def test_engine_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gapscope.envs.engines.installed", lambda name: False)
    with pytest.raises(InputError, match="not installed") as caught:
        check_engine("mujoco")
    assert "pip install mujoco" in caught.value.remedy


def test_pybullet_is_loaded_in_silence() -> None:
    """It says on standard error when it was built; what comes after it is heard."""
    pytest.importorskip("pybullet")
    code = "import sys, gapscope.envs.engines.pybullet; print('heard', file=sys.stderr)"
    how = {"capture_output": True, "text": True, "timeout": HANG}
    done = subprocess.run([sys.executable, "-c", code], **how)
    assert (done.returncode, done.stdout, done.stderr.split()) == (0, "", ["heard"])
