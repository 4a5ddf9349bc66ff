"""The closed loop rolled out by pinocchio: closed-form motions, and sensitivities against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import ROD, chain
from cases import sines

from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ClosedLoop, Commands, ticks_per_step
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
    energy = 0.5 * INERTIA * out.speed[:, 0] ** 2 - WEIGHT * np.sin(out.q[:, 0])
    assert np.ptp(out.q) > 1.5
    assert np.ptp(energy) < 1e-3 * WEIGHT


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
    assert out.speed[apart, 0] == pytest.approx(speed(out.t[apart]), abs=2e-3)


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


def test_several_roll_outs_at_once_are_those_one_by_one(data_arm, motion):
    loop = ClosedLoop(RigidBody(data_arm), pd(7, 500, 50, **SOFT), np.full(7, 60.0))
    plant = plant_of(data_arm, 0.3, 2.0, 1.0, 0.2)
    short = Commands(
        motion.t[:700] + 3.0, *(x[-700:] for x in (motion.q, motion.dq, motion.torque))
    )
    together = loop.roll_outs(plant, [motion, short])
    directions = np.random.default_rng(2).standard_normal((98, 2))
    along = loop.sensitivities(plant, together, directions)
    for commands, both, derivatives in zip(
        (motion, short), together, along, strict=True
    ):
        alone = roll_out(loop, plant, commands)
        for name in ("t", "q", "dq", "tau", "speed"):
            assert getattr(both, name) == pytest.approx(getattr(alone, name), abs=1e-9)
        (own,) = loop.sensitivities(plant, [alone], directions)
        for found, expected in zip(derivatives, own, strict=True):
            assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_the_roll_out_that_runs_away_is_named_by_its_time(floating):
    still = hold(5.0, [0.0])
    commands = [still, replace(still, t=still.t + 100.0)]
    starts = [(np.zeros(1), speed) for speed in (np.zeros(1), np.ones(1))]
    loop = ClosedLoop(RigidBody(floating), pd(1, -2000.0))
    message = r"(?s)diverged at joint 1, at t = 10\d.*gains"
    with pytest.raises(GapscopeError, match=message):
        loop.roll_outs(plant_of(floating), commands, starts)


def assert_slopes(loop, commands, vector, ways, near, step=1e-4):
    """Along each way the derivatives of position and torque are near finite differences."""
    every = ticks_per_step(loop.controller)

    def rolled(change):
        return roll_out(loop, vector + change, commands)

    ((q, tau),) = loop.sensitivities(vector, [rolled(0.0)], ways)
    for k, way in enumerate(ways.T):
        up, down = rolled(step * way), rolled(-step * way)
        for along, high, low in ((q, up.q, down.q), (tau, up.tau, down.tau)):
            assert near(along[..., k], (high - low)[::every] / (2 * step))


@pytest.mark.nightly
def test_close_ticks_share_a_step_of_the_sensitivity(rod):
    """At 4 kHz a derivative is taken every fourth tick, and is off by less than a fiftieth (RMS)."""
    t = np.arange(8001) / 4000
    q = 0.5 * np.sin(3 * t)[:, None]
    commands = Commands(t, q, 1.5 * np.cos(3 * t)[:, None], np.zeros_like(q))
    controller = PD(rate=4000.0, kp=np.full(1, 200.0), kd=np.full(1, 20.0), **SOFT)
    body = RigidBody(rod)
    vector = np.r_[body.inertial_parameters(), 0.3, 2.0, 0.5, 0.1]
    ways = np.eye(14)[:, [0, 10, 11, 12]]
    assert ticks_per_step(controller) == 4
    assert_slopes(
        *(ClosedLoop(body, controller), commands, vector, ways),
        lambda x, numeric: np.std(x - numeric) <= 0.02 * np.std(numeric),
    )


@pytest.mark.parametrize("swapped", [False, True])
def test_sensitivities_are_those_of_finite_differences(data_arm, motion, swapped):
    if swapped:
        way = np.array([3, 0, 6, 1, 5, 2, 4])
        joints = tuple(np.array(data_arm.joints)[way])
        data_arm = NominalArm("other", data_arm.urdf, joints)
        motion = Commands(motion.t, motion.q[:, way], motion.dq[:, way], motion.torque)
    body, rng = RigidBody(data_arm), np.random.default_rng(1)
    friction = np.repeat([0.3, 2.0, 1.0, 0.2], 7)
    vector = np.r_[body.inertial_parameters(), friction]
    size = 0.1 * np.maximum(np.abs(vector), 0.01)
    ways = rng.standard_normal((98, 2)) * size[:, None]
    loop = ClosedLoop(body, pd(7, 500, 50, **SOFT), np.full(7, 60.0))
    assert_slopes(
        *(loop, motion, vector, ways),
        lambda x, numeric: np.abs(x - numeric).max() < 1e-4 * np.abs(numeric).max(),
    )


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
