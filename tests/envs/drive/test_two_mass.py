"""Joints with two masses against closed formulas: resonance, damping, deflection, free play."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit
from sweeps import daily

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import TorqueLaw
from gapscope.effects.parameter import Parameter
from gapscope.envs.engines import ENGINES
from gapscope.envs.simulated_arm import SimulatedArm

LINK = 0.55
"""Inertia of the pendulum about its hinge [kg m^2]."""
PLAY = AppliedEffect("backlash", (1,), {"width": [0.01]})


def elastic(stiffness: float, damping: float) -> AppliedEffect:
    values = {"stiffness": [stiffness], "damping": [damping]}
    return AppliedEffect("joint_elasticity", (1,), values)


def _decay(t: np.ndarray, a: float, w: float, zeta: float, phase: float) -> np.ndarray:
    return a * np.exp(-zeta * w * t) * np.sin(w * np.sqrt(1 - zeta**2) * t + phase)


@pytest.mark.parametrize(
    ("armature", "stiffness", "zeta"),
    [(0.3, 1e3, 0.02), (0.3, 1e4, 0.05), (1.0, 5e4, 0.02), (0.05, 1e4, 0.03)],
)
def test_resonance_and_damping(
    pendulum, armature: float, stiffness: float, zeta: float
) -> None:
    """Of the twist after a blow on the motor: w^2 = k (1/I + 1/M) and 2 zeta w = d (1/I + 1/M), within 1 %."""
    arm = replace(pendulum(armature=armature), gravity=np.zeros(3))
    inertia = 1 / (1 / armature + 1 / LINK)
    w = np.sqrt(stiffness / inertia)
    spring = elastic(stiffness, 2 * zeta * w * inertia)
    with SimulatedArm(arm, (spring,), 1e-3) as simulated:
        simulated.step(np.array([10.0]))
        twist = []
        for _ in range(500):
            twist.append(float((simulated.motor_q - simulated.q)[0]))
            simulated.step(np.zeros(1))
    start = [max(twist), 0.97 * w, 1.1 * zeta, 0.1]
    found, _ = curve_fit(_decay, 1e-3 * np.arange(500), twist, p0=start)
    assert found[1:3] == pytest.approx([w, zeta], rel=0.01)


@pytest.mark.parametrize("encoder", ["motor", "joint"])
def test_motor_leads_its_link_by_the_load_over_the_stiffness(
    pendulum, encoder: str
) -> None:
    """A horizontal rod needs -9.81 N m; with k = 500 N m/rad the motor leads by -0.01962 rad."""
    arm = replace(pendulum(armature=0.3), encoder=encoder)
    with SimulatedArm(arm, (elastic(500.0, 5.0),)) as simulated:
        simulated.reset(np.zeros(1))
        for _ in range(100):
            simulated.step(np.array([-9.81]))
        assert simulated.motor_q - simulated.q == pytest.approx([-0.01962], rel=1e-6)
        side = simulated.motor_q if encoder == "motor" else simulated.q
        assert simulated.encoders() == pytest.approx(side)


def test_start_puts_the_encoder_where_it_is_asked_to_be(pendulum) -> None:
    offset = AppliedEffect("encoder_offset", (1,), {"offset": [0.03]})
    effects = (elastic(500.0, 5.0), PLAY, offset)
    with SimulatedArm(pendulum(armature=0.3), effects) as simulated:
        simulated.start(np.array([0.3]))
        assert simulated.encoders() == pytest.approx([0.3], abs=1e-9)


@pytest.mark.parametrize("others", [(), (elastic(5000.0, 1.0),)])
def test_an_own_law_of_load_acts_on_a_rigid_joint_beside_any_other(
    bare_arm: NominalArm, monkeypatch: pytest.MonkeyPatch, others: tuple
) -> None:
    """A loss of half the load makes 20 N m the 10 N m that they are without it."""
    loss = TorqueLaw(
        *("loss", "friction", "joint", ""),
        (Parameter("share", "s", "1", (0.0, 1.0), (0.1, 0.3)),),
        *("", ""),
        law=lambda signals, share: share * signals.load,
    )
    monkeypatch.setitem(CATALOGUE, "loss", loss)
    arm = replace(bare_arm, armature=np.ones(7), gravity=np.zeros(3))
    own, speeds = AppliedEffect("loss", (2,), {"share": [0.5]}), []
    for effects, torque in ((others, 10.0), ((*others, own), 20.0)):
        with SimulatedArm(arm, effects) as simulated:
            simulated.step(torque * np.eye(7)[1], 20)
            speeds.append(simulated.dq)
    assert speeds[1] == pytest.approx(speeds[0], rel=1e-9) and speeds[0][1] > 0.01


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
@pytest.mark.parametrize(("dt", "allowed"), [(1e-3, 1e-3), (1e-4, 1e-4)])
def test_energy_only_falls(
    engines, pendulum, engine: str, dt: float, allowed: float
) -> None:
    """Kinetic energy of both sides and of the spring, after a blow, with damping and free play.

    Discretisation lets it rise by up to 7e-5 of itself at 0.1 ms, which falls with the square of the step.
    """
    arm = replace(pendulum(armature=0.3), gravity=np.zeros(3))
    effects, energies = (PLAY, elastic(2000.0, 2.0)), []
    with SimulatedArm(arm, effects, dt, engine=engines(engine)) as simulated:
        simulated.step(np.array([0.2 / dt]))
        for _ in range(round(0.5 / dt)):
            twist = simulated.motor_q - simulated.q
            wound = np.maximum(np.abs(twist) - 0.005, 0.0)
            speed = simulated.motors.velocity
            parts = 0.15 * speed**2, 0.5 * LINK * simulated.dq**2, 1000.0 * wound**2
            energies.append(float(sum(parts)[0]))
            simulated.step(np.zeros(1))
    energy = np.array(energies)
    risen = (energy - np.minimum.accumulate(energy)).max()
    assert risen < allowed * energy[0] and energy[-1] < 0.5 * energy[0]
