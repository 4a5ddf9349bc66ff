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


def roll_out(loop, plant, commands, start=None):
    """One series of commands."""
    starts = None if start is None else [start]
    return loop.roll_outs(plant, [commands], starts)[0]


@pytest.fixture
def rod(tmp_path):
    return chain(tmp_path, "rod", ROD)


@pytest.fixture
def floating(rod):
    """Without gravity."""
    return replace(rod, gravity=np.zeros(3))


def plant_of(arm, armature=0.0, viscous=0.0, coulomb=0.0, offset=0.0):
    n = arm.n_joints
    laws = [
        np.broadcast_to(np.asarray(x, dtype=float), n)
        for x in (armature, viscous, coulomb, offset)
    ]
    return np.concatenate([RigidBody(arm).inertial_parameters(), *laws])


def pd(n, kp=0.0, kd=0.0, **other):
    return PD(rate=1000.0, kp=np.full(n, kp), kd=np.full(n, kd), **other)


def hold(duration, q):
    t = np.arange(round(duration * 1000) + 1) / 1000
    q = np.broadcast_to(np.asarray(q, dtype=float), (len(t), len(np.atleast_1d(q))))
    return Commands(t, q, np.zeros_like(q), np.zeros_like(q))


def test_a_rod_without_friction_keeps_its_energy(rod):
    loop = ClosedLoop(RigidBody(rod), pd(1))
    out = roll_out(loop, plant_of(rod), hold(5.0, [0.3]))
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
    start = (np.zeros(1), np.ones(1))
    loop = ClosedLoop(RigidBody(floating), pd(1))
    out = roll_out(loop, plant, hold(1.0, [0.0]), start)
    # the dry law bends where it comes to rest
    apart = np.abs(out.t - 0.5) > 0.05
    found = np.gradient(out.q[:, 0], out.t)
    assert found[apart] == pytest.approx(speed(out.t[apart]), abs=2e-3)


@pytest.fixture
def motion(data_arm):
    t = np.arange(1501) / 1000
    rng = np.random.default_rng(0)
    rate, phase = rng.uniform(1, 4, 7), rng.uniform(0, 6, 7)
    seen = sines(t, 0.5, rate, phase)
    return Commands(t, seen.q, seen.dq, np.zeros_like(seen.q))


@pytest.fixture
def data_arm():
    pytest.importorskip("pybullet_data")
    return load_nominal_arm("kuka_iiwa")


SOFT = {"velocity_cutoff": 80.0}


def test_roll_outs_of_several_arms_at_once_are_those_one_by_one(data_arm, motion):
    loop = ClosedLoop(RigidBody(data_arm), pd(7, 500, 50, **SOFT), np.full(7, 60.0))
    plants = plant_of(data_arm, 0.3, 2.0, 1.0, 0.2) * [[1.0], [1.1]]
    short = Commands(
        motion.t[:700] + 3.0, *(x[-700:] for x in (motion.q, motion.dq, motion.torque))
    )
    together = loop.roll_outs(plants, [motion, short])
    for plant, commands, both in zip(plants, (motion, short), together, strict=True):
        alone = roll_out(loop, plant, commands)
        for name in ("t", "q", "dq", "tau"):
            assert getattr(both, name) == pytest.approx(getattr(alone, name), abs=1e-9)


def test_joints_in_another_order_move_alike(data_arm, motion):
    way = np.array([3, 0, 6, 1, 5, 2, 4])
    other = NominalArm("other", data_arm.urdf, tuple(np.array(data_arm.joints)[way]))
    swapped = Commands(
        motion.t, motion.q[:, way], motion.dq[:, way], motion.torque[:, way]
    )
    laws = np.arange(1.0, 8.0) * [[0.1], [1.0], [0.5], [0.2]]
    out = []
    for arm, commands, own in (
        (data_arm, motion, laws),
        (other, swapped, laws[:, way]),
    ):
        loop = ClosedLoop(RigidBody(arm), pd(7, 500, 50, **SOFT))
        out.append(roll_out(loop, 1.1 * plant_of(arm, *own), commands))
    assert out[1].tau == pytest.approx(out[0].tau[:, way], abs=1e-6)


def test_the_roll_out_that_runs_away_is_named_by_its_time(floating):
    still = hold(5.0, [0.0])
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
