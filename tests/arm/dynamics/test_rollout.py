"""The closed loop rolled out by pinocchio: closed-form motions, and several at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import ROD, chain
from cases import sines

from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ClosedLoop, Commands
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm

INERTIA, WEIGHT = 0.55, 9.81
"""Of the rod about its hinge [kg m^2], and its gravity torque at the horizontal [N m]."""


@pytest.fixture
def rod(tmp_path):
    return chain(tmp_path, "rod", ROD)


@pytest.fixture
def floating(rod):
    """Without gravity."""
    return replace(rod, gravity=np.zeros(3))


def plant_of(arm, armature=0.0, viscous=0.0, coulomb=0.0, offset=0.0):
    laws = [x + np.zeros(arm.n_joints) for x in (armature, viscous, coulomb, offset)]
    return np.concatenate([RigidBody(arm).inertial_parameters(), *laws])


def pd(n, kp=0.0, kd=0.0, **other):
    return PD(rate=1000.0, kp=np.full(n, kp), kd=np.full(n, kd), **other)


def hold(duration, q):
    t = np.arange(round(duration * 1000) + 1) / 1000
    still = np.zeros((len(t), 1))
    return Commands(t, still + q, still, still)


def test_a_rod_without_friction_keeps_its_energy(rod):
    loop = ClosedLoop(RigidBody(rod), pd(1))
    (out,) = loop.roll_outs(plant_of(rod), [hold(3.0, 0.3)])
    speed = np.gradient(out.q[:, 0], out.t)
    energy = 0.5 * INERTIA * speed**2 - WEIGHT * np.sin(out.q[:, 0])
    assert np.ptp(out.q) > 1.5
    # differences at the ends are one-sided
    assert np.ptp(energy[1:-1]) < 1e-3 * WEIGHT


SLOWED = {
    "viscous": ({"viscous": 3.0}, lambda t: np.exp(-3.0 * t)),
    "coulomb": ({"coulomb": 2.0}, lambda t: np.maximum(1.0 - 2.0 * t, 0.0)),
}
"""Friction of a body of 1 kg m^2, and its speed from 1 rad/s on."""


@pytest.mark.parametrize("name", SLOWED)
def test_friction_slows_a_rod_down_and_holds_it(floating, name):
    friction, speed = SLOWED[name]
    plant = plant_of(floating, armature=0.45, **friction)
    starts = [(np.zeros(1), np.ones(1))]
    loop = ClosedLoop(RigidBody(floating), pd(1))
    (out,) = loop.roll_outs(plant, [hold(1.0, 0.0)], starts)
    # the dry law bends where it comes to rest
    apart = np.abs(out.t - 0.5) > 0.05
    found = np.gradient(out.q[:, 0], out.t)
    assert found[apart] == pytest.approx(speed(out.t[apart]), abs=2e-3)


def commands_of(joints):
    """Half a second of those joints of the iiwa."""
    rng = np.random.default_rng(0)
    rate, phase = rng.uniform(1, 4, 7), rng.uniform(0, 6, 7)
    seen = sines(np.arange(501) / 1000, 0.5, rate[joints], phase[joints])
    return Commands(seen.t, seen.q, seen.dq, np.zeros_like(seen.q))


@pytest.fixture
def data_arm():
    pytest.importorskip("pybullet_data")
    return load_nominal_arm("kuka_iiwa")


SOFT = {"velocity_cutoff": 80.0}
ALL = np.arange(7)


def test_roll_outs_of_several_arms_at_once_are_those_one_by_one(data_arm):
    loop = ClosedLoop(RigidBody(data_arm), pd(7, 500, 50, **SOFT), np.full(7, 60.0))
    plants = plant_of(data_arm, 0.3, 2.0, 1.0, 0.2) * [[1.0], [1.1]]
    motion = commands_of(ALL)
    parts = (x[-250:] for x in (motion.q, motion.dq, motion.torque))
    both = [motion, Commands(motion.t[:250] + 3.0, *parts)]
    together = loop.roll_outs(plants, both)
    for plant, commands, out in zip(plants, both, together, strict=True):
        (alone,) = loop.roll_outs(plant, [commands])
        for name in ("t", "q", "dq", "tau"):
            assert getattr(out, name) == pytest.approx(getattr(alone, name), abs=1e-9)


def test_joints_in_another_order_move_alike(data_arm):
    way, tau = np.array([3, 0, 6, 1, 5, 2, 4]), []
    laws = np.arange(1.0, 8.0) * [[0.1], [1.0], [0.5], [0.2]]
    for joints in (ALL, way):
        names = tuple(np.array(data_arm.joints)[joints])
        arm = NominalArm("iiwa", data_arm.urdf, names)
        loop = ClosedLoop(RigidBody(arm), pd(7, 500, 50, **SOFT))
        plant = 1.1 * plant_of(arm, *laws[:, joints])
        (out,) = loop.roll_outs(plant, [commands_of(joints)])
        tau.append(out.tau)
    assert tau[1] == pytest.approx(tau[0][:, way], abs=1e-6)


def test_the_roll_out_that_runs_away_is_named_by_its_time(floating):
    still = hold(5.0, 0.0)
    commands = [still, replace(still, t=still.t + 100.0)]
    starts = [(np.zeros(1), speed) for speed in (np.zeros(1), np.ones(1))]
    loop = ClosedLoop(RigidBody(floating), pd(1, -2000.0))
    message = r"(?s)diverged at joint 1, at t = 10\d.*gains"
    with pytest.raises(GapscopeError, match=message):
        loop.roll_outs(plant_of(floating), commands, starts)


# Derivatives of the inverse dynamics against finite differences, for bodies as least squares may return them.


STEP = 1e-6


@pytest.mark.parametrize("negative", [(), (2, 3, 4, 5)])
def test_derivatives_are_those_of_the_inverse_dynamics_whatever_the_masses(
    negative: tuple[int, ...],
) -> None:
    """Identified masses may be negative: single parameters of a fit are not determined."""
    nominal = RigidBody(load_nominal_arm("kuka_iiwa"))
    rng = np.random.default_rng(0)
    change = 0.05 * rng.standard_normal((7, 10))
    change[list(negative), 0] -= 9.0
    body, state = nominal.changed(change), rng.standard_normal((3, 2, 7))
    for which, derivative in enumerate(body.sensitivities(*state)):
        for j in range(7):
            step = np.zeros_like(state)
            step[which, :, j] = STEP
            ahead, behind = (
                body.inverse_dynamics(*(state + s * step)) for s in (1, -1)
            )
            central = (ahead - behind) / (2 * STEP)
            assert derivative[:, :, j] == pytest.approx(central, abs=1e-5)
