"""A motor that turns two joints, simulated: the torque that its law says, whatever the engine; it sticks, and stays."""

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.engines import ENGINES
from gapscope.envs.simulated_arm import SimulatedArm

DT = 1e-3
EFFECTS = (
    AppliedEffect("coupled_coulomb_friction", (7,), {"torque": [1.0]}),
    AppliedEffect("coupled_viscous_friction", (7,), {"coefficient": [0.5]}),
    AppliedEffect("coupled_armature", (7,), {"inertia": [0.2]}),
    AppliedEffect("coulomb_friction", (6,), {"torque": [0.5]}),
)


def wrist() -> NominalArm:
    sheet = {"armature": [0.1] * 7, "viscous": [0.5] * 7}
    sheet["coupling"] = [{"motor": 7, "joint": 6, "ratio": -1.0}]
    return load_nominal_arm("kuka_iiwa", sheet=sheet)


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_the_simulated_motion_needs_the_torque_that_the_law_says(
    engines, engine: str
) -> None:
    arm = wrist()
    body, corrected = RigidBody(arm), CorrectedArm(arm, EFFECTS)
    start = np.array([0.1, 0.4, -0.2, -0.8, 0.3, 0.5, 0.2])
    with SimulatedArm(arm, EFFECTS, DT, engine=engines(engine)) as simulated:
        simulated.reset(start)
        q, dq, torque = [], [], []
        for k in range(600):
            push = 4.0 * np.sin(0.012 * k + np.arange(7))
            torque.append(body.bias(simulated.q, np.zeros(7)) + push)
            q.append(simulated.q)
            dq.append(simulated.dq)
            simulated.step(torque[-1])
    before, after = np.array(dq[:-1]), np.array(dq[1:])
    at, acceleration = np.array(q[:-1]), (after - before) / DT
    rigid = body.inverse_dynamics(at, before, acceleration)
    motion = Motion(DT * np.arange(len(at)), at, after, acceleration)
    needed = corrected.needed_torque(rigid, motion)
    # the smoothed sign of the law says nothing about a joint or a motor at rest
    speeds = np.column_stack([after, after @ arm.coupling[6]])
    moving = (np.abs(speeds) > 0.03).all(axis=1)
    assert moving.mean() > 0.3
    error = (np.array(torque[:-1]) - needed)[moving]
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_joints_of_a_sticking_motor_move_together(engines, engine: str) -> None:
    """Joints 6 and 7 pushed alike do not turn motor 7, whose speed is dq7 - dq6, if that sticks hard enough."""
    arm = wrist()
    strong = (AppliedEffect("coupled_coulomb_friction", (7,), {"torque": [50.0]}),)
    body = RigidBody(arm)
    with SimulatedArm(arm, strong, DT, engine=engines(engine)) as simulated:
        simulated.reset(np.zeros(7))
        for _ in range(300):
            simulated.step(body.bias(simulated.q, np.zeros(7)) + 2.0 * np.eye(7)[5])
        speed = simulated.dq
    assert speed[5] > 0.05
    assert speed[6] == pytest.approx(speed[5], rel=1e-3)
