"""Friction of a simulated arm: sticking, drift, passivity."""

from dataclasses import replace

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.simulated_arm import SimulatedArm

ALL = (1, 2, 3, 4, 5, 6, 7)
SLOPE = np.array([0.2, 0.5, -0.3, -0.9, 0.3, 0.6, 0.1])


@pytest.mark.parametrize("engine", ENGINES)
def test_arm_held_by_friction_on_a_slope_does_not_creep(
    engines, data_sheet_arm: NominalArm, engine: str
) -> None:
    """20 s at steps of 1 ms, each joint's gravity torque below its friction: less than 1e-7 rad."""
    arm = replace(data_sheet_arm, coulomb=np.full(7, 60.0), viscous=np.zeros(7))
    with SimulatedArm(arm, engine=engines(engine)) as simulated:
        simulated.reset(SLOPE)
        simulated.step(np.zeros(7), 20_000)
        assert np.abs(simulated.q - SLOPE).max() < 1e-7
        assert np.abs(simulated.dq).max() < 1e-9


def test_stribeck_friction_breaks_away_and_slides_on(pendulum) -> None:
    """2 N m to break away, 1 N m to slide: 1.9 N m leave it at rest; once pushed it goes on under 1.9 N m."""
    arm = replace(pendulum(coulomb=1.0), gravity=np.zeros(3))
    drop = {"torque": [1.0], "velocity": [0.01]}
    with SimulatedArm(arm, (AppliedEffect("stribeck_friction", (1,), drop),)) as rod:
        rod.step(np.array([1.9]), 500)
        assert rod.dq == pytest.approx([0.0], abs=1e-9)
        rod.step(np.array([20.0]), 20)
        before = rod.dq
        rod.step(np.array([1.9]), 100)
        assert rod.dq - before == pytest.approx([0.1 * 0.9 / 0.55], rel=1e-3)


STRONG = {"torque": 2.0, "amplitude": 2.0, "coefficient": 0.7, "velocity": 1.0, "time_constant": 1.0}  # fmt: skip
FRICTION = [name for name, effect in CATALOGUE.items() if effect.family == "friction"]


@pytest.mark.parametrize("name", FRICTION)
@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_friction_takes_energy_out(
    engines, data_sheet_arm: NominalArm, engine: str, name: str
) -> None:
    """A swing without gravity loses energy at every step; load friction shows under a held torque only."""
    base = np.full(7, 1.0 if name == "friction_drift" else 0.0)
    arm = replace(data_sheet_arm, gravity=np.zeros(3), coulomb=base, viscous=base)
    values = {x: STRONG[x] for x in CATALOGUE[name].names}
    torque = np.full(7, 2.0) if name == "load_friction" else np.zeros(7)
    lost = []
    for effects in ((), (AppliedEffect(name, ALL, values),)):
        with SimulatedArm(arm, effects, engine=engines(engine)) as simulated:
            simulated.reset(SLOPE, np.array([0.5, -0.4, 0.6, 0.5, -0.6, 0.7, 0.5]))
            energy, work = [_kinetic(simulated)], 0.0
            for _ in range(100):
                before = simulated.q
                simulated.step(torque)
                work += float(torque @ (simulated.q - before))
                energy.append(_kinetic(simulated) - work)
        assert not effects or np.diff(energy).max() < 1e-6
        lost.append(energy[0] - energy[-1])
    assert lost[1] > 0.1 + 1.02 * lost[0]


def _kinetic(simulated: SimulatedArm) -> float:
    inertia = simulated.body.mass_matrix(simulated.q) + np.diag(simulated.arm.armature)
    return float(0.5 * simulated.dq @ inertia @ simulated.dq)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("share", "moves"), [(0.97, False), (1.03, True)])
def test_joints_break_away_at_their_limit_on_every_engine(
    engines, bare_arm: NominalArm, engine: str, share: float, moves: bool
) -> None:
    """Pushed beside its weight, each joint alone, for long enough that a sticking one has come to rest."""
    limit = np.array([3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5])
    arm = replace(bare_arm, coulomb=limit)
    for joint in range(7):
        with SimulatedArm(arm, engine=engines(engine)) as simulated:
            simulated.reset(POSTURE)
            push = simulated.body.bias(POSTURE, np.zeros(7))
            push[joint] += share * limit[joint]
            simulated.step(push, 50)
            assert bool(abs(simulated.dq[joint]) > 0) is moves, joint


@pytest.mark.parametrize(
    ("torque", "moves"), [(19.0, 0), (20.2, 1), (7.0, 0), (6.0, -1)]
)
def test_load_friction_sticks_up_to_its_share_of_the_motor_torque(
    pendulum, torque: float, moves: int
) -> None:
    """mu = 0.5 under a gravity torque of 9.81 N m: up beyond 9.81 / (1 - mu), down below 9.81 / (1 + mu) N m."""
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.5]})
    with SimulatedArm(pendulum(), (friction,)) as simulated:
        for _ in range(100):
            simulated.step(np.array([-torque]))
        assert (-np.sign(simulated.q[0]) if abs(simulated.q[0]) > 1e-6 else 0) == moves


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_joints_of_a_sticking_motor_move_together(
    engines, coupled_arm: NominalArm, engine: str
) -> None:
    """Joints 6 and 7 pushed alike do not turn motor 7 if that sticks hard enough."""
    strong = AppliedEffect("coupled_coulomb_friction", (7,), {"torque": [50.0]})
    arm = replace(coupled_arm, armature=np.full(7, 0.1), viscous=np.full(7, 0.5))
    with SimulatedArm(arm, (strong,), engine=engines(engine)) as simulated:
        simulated.reset(np.zeros(7))
        for _ in range(300):
            bias = simulated.body.bias(simulated.q, np.zeros(7))
            simulated.step(bias + 2.0 * np.eye(7)[5])
        speed = simulated.dq
    assert speed[5] > 0.05
    assert speed[6] == pytest.approx(speed[5], rel=1e-3)
