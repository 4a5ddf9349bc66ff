"""The closed loop rolled out by pinocchio: closed-form motions, and sensitivities against finite differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import ROD, chain
from cases import sines

from gapscope.arm.control import PD, feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import (
    Commands,
    Plant,
    roll_outs,
    sensitivity,
    ticks_per_step,
)
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm

INERTIA, WEIGHT = 0.55, 9.81
"""Of the rod about its hinge [kg m^2], and its gravity torque at the horizontal [N m]."""


def roll_out(body, plant, controller, commands, limit=None, start=None):
    """One series of commands."""
    starts = None if start is None else [start]
    return roll_outs(body, plant, controller, [commands], limit, starts)[0]


@pytest.fixture
def rod(tmp_path):
    return chain(tmp_path, "rod", ROD)


def plant_of(arm, armature=0.0, viscous=0.0, coulomb=0.0, offset=0.0):
    n = arm.n_joints
    laws = [
        np.broadcast_to(np.asarray(x, dtype=float), n)
        for x in (armature, viscous, coulomb, offset)
    ]
    return Plant.of(np.concatenate([RigidBody(arm).inertial_parameters(), *laws]))


def pd(n, kp=0.0, kd=0.0, **other):
    return PD(rate=1000.0, kp=np.full(n, kp), kd=np.full(n, kd), **other)


def hold(duration, q):
    t = np.arange(round(duration * 1000) + 1) / 1000
    q = np.broadcast_to(np.asarray(q, dtype=float), (len(t), len(np.atleast_1d(q))))
    return Commands(t, q, np.zeros_like(q), np.zeros_like(q))


def test_a_rod_without_friction_keeps_its_energy(rod):
    out = roll_out(RigidBody(rod), plant_of(rod), pd(1), hold(5.0, [0.3]))
    energy = 0.5 * INERTIA * out.speed[:, 0] ** 2 - WEIGHT * np.sin(out.q[:, 0])
    assert np.ptp(out.q) > 1.5
    assert np.ptp(energy) < 1e-3 * WEIGHT


def test_position_control_sags_by_gravity_over_stiffness_and_an_offset_lifts(rod):
    commands = hold(3.0, [0.0])
    plain = roll_out(RigidBody(rod), plant_of(rod), pd(1, 200.0, 30.0), commands)
    sag = plain.q[-1, 0]
    assert 200.0 * sag == pytest.approx(WEIGHT * np.cos(sag), rel=1e-5)
    lifted = roll_out(
        RigidBody(rod), plant_of(rod, offset=-WEIGHT), pd(1, 200.0, 30.0), commands
    )
    assert lifted.q[-1, 0] == pytest.approx(0.0, abs=1e-6)
    assert lifted.tau[-1, 0] == pytest.approx(0.0, abs=1e-4)


def test_dry_friction_stops_a_rod_at_constant_deceleration_and_holds_it(rod):
    floating = NominalArm("rod", rod.urdf, rod.joints, gravity=np.zeros(3))
    start = (np.zeros(1), np.full(1, 1.0))
    plant = plant_of(floating, armature=0.45, coulomb=2.0)
    out = roll_out(RigidBody(floating), plant, pd(1), hold(1.0, [0.0]), start=start)
    moving = out.t < 0.45
    assert out.speed[moving, 0] == pytest.approx(1.0 - 2.0 * out.t[moving], abs=2e-3)
    assert np.abs(out.speed[out.t > 0.6]).max() < 1e-3


def test_viscous_friction_decays_exponentially(rod):
    floating = NominalArm("rod", rod.urdf, rod.joints, gravity=np.zeros(3))
    out = roll_out(
        RigidBody(floating),
        plant_of(floating, armature=0.45, viscous=3.0),
        pd(1),
        hold(1.0, [0.0]),
        start=(np.zeros(1), np.ones(1)),
    )
    assert out.speed[:, 0] == pytest.approx(np.exp(-3.0 * out.t), abs=2e-3)


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
    from gapscope.arm.robots import load_nominal_arm

    return load_nominal_arm("kuka_iiwa")


SOFT = {"velocity_cutoff": 80.0}


def test_several_roll_outs_at_once_are_those_one_by_one(data_arm, motion):
    body, controller = RigidBody(data_arm), pd(7, 500, 50, **SOFT)
    plant = plant_of(data_arm, 0.3, 2.0, 1.0, 0.2)
    short = Commands(
        motion.t[:700] + 3.0, *(x[-700:] for x in (motion.q, motion.dq, motion.torque))
    )
    together = roll_outs(body, plant, controller, [motion, short], np.full(7, 60.0))
    directions = np.random.default_rng(2).standard_normal((98, 2))
    along = sensitivity(body, plant, controller, together, directions)
    for commands, both, derivatives in zip(
        (motion, short), together, along, strict=True
    ):
        alone = roll_out(body, plant, controller, commands, np.full(7, 60.0))
        for name in ("t", "q", "dq", "tau", "speed"):
            assert getattr(both, name) == pytest.approx(getattr(alone, name), abs=1e-9)
        (own,) = sensitivity(body, plant, controller, [alone], directions)
        for found, expected in zip(derivatives, own, strict=True):
            assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_the_roll_out_that_runs_away_is_named_by_its_time(rod):
    floating = NominalArm("rod", rod.urdf, rod.joints, gravity=np.zeros(3))
    still, late = hold(5.0, [0.0]), hold(5.0, [0.0])
    late = Commands(late.t + 100.0, late.q, late.dq, late.torque)
    starts = [(np.zeros(1), np.zeros(1)), (np.zeros(1), np.ones(1))]
    with pytest.raises(
        GapscopeError, match=r"(?s)diverged at joint 1, at t = 10\d.*gains"
    ):
        roll_outs(
            RigidBody(floating),
            plant_of(floating),
            pd(1, -2000.0, 0.0),
            [still, late],
            starts=starts,
        )


@pytest.mark.nightly
def test_close_ticks_share_a_step_of_the_sensitivity(rod):
    """At 4 kHz a derivative is taken every fourth tick, and is off by less than a fiftieth (RMS)."""
    t = np.arange(8001) / 4000
    q = 0.5 * np.sin(3 * t)[:, None]
    commands = Commands(t, q, 1.5 * np.cos(3 * t)[:, None], np.zeros_like(q))
    controller = PD(rate=4000.0, kp=np.full(1, 200.0), kd=np.full(1, 20.0), **SOFT)
    vector = np.concatenate(
        [RigidBody(rod).inertial_parameters(), [0.3, 2.0, 0.5, 0.1]]
    )
    body, directions = RigidBody(rod), np.eye(14)[:, [0, 10, 11, 12]]
    rolled = roll_out(body, Plant.of(vector), controller, commands)
    ((q, tau),) = sensitivity(body, Plant.of(vector), controller, [rolled], directions)
    assert ticks_per_step(controller) == 4 and len(q) == 2001
    for k, way in enumerate(directions.T):
        up, down = (
            roll_out(body, Plant.of(vector + s * 1e-4 * way), controller, commands)
            for s in (1, -1)
        )
        for along, high, low in ((q, up.q, down.q), (tau, up.tau, down.tau)):
            numeric = (high - low)[::4] / 2e-4
            assert np.std(along[..., k] - numeric) <= 0.02 * np.std(numeric)


@pytest.mark.parametrize("swapped", [False, True])
def test_sensitivities_are_those_of_finite_differences(data_arm, motion, swapped):
    if swapped:
        way = np.array([3, 0, 6, 1, 5, 2, 4])
        data_arm = NominalArm(
            "other", data_arm.urdf, tuple(np.array(data_arm.joints)[way])
        )
        motion = Commands(motion.t, motion.q[:, way], motion.dq[:, way], motion.torque)
    body, rng = RigidBody(data_arm), np.random.default_rng(1)
    vector = np.concatenate(
        [
            body.inertial_parameters(),
            np.full(7, 0.3),
            np.full(7, 2.0),
            np.ones(7),
            np.full(7, 0.2),
        ]
    )
    directions = (
        rng.standard_normal((98, 2)) * np.maximum(np.abs(vector), 0.01)[:, None] * 0.1
    )
    limit = np.full(7, 60.0)
    controller = pd(7, 500, 50, **SOFT)
    rolled = roll_out(body, Plant.of(vector), controller, motion, limit)
    ((q, tau),) = sensitivity(
        body, Plant.of(vector), controller, [rolled], directions, limit
    )
    step = 1e-4
    for k in range(2):
        up, down = (
            roll_out(
                body,
                Plant.of(vector + s * step * directions[:, k]),
                controller,
                motion,
                limit,
            )
            for s in (1, -1)
        )
        for along, high, low in ((q, up.q, down.q), (tau, up.tau, down.tau)):
            numeric = (high - low) / (2 * step)
            assert np.abs(along[..., k] - numeric).max() < 1e-4 * np.abs(numeric).max()


# The feedforward law, on a pendulum worked by hand.


@pytest.fixture
def arm(tmp_path: Path) -> NominalArm:
    """2 kg at 0.5 m, inertia 0.55 kg m^2 about the hinge."""
    return chain(
        tmp_path, "pendulum", ROD, armature=[0.2], coulomb=[3.0], viscous=[0.7]
    )


def test_laws_by_hand(arm: NominalArm) -> None:
    q, dq, ddq = np.array([[0.0]]), np.array([[0.005]]), np.array([[2.0]])
    gravity = -9.81  # the rod points along x, gravity turns it about +y
    nominal = gravity + (0.55 + 0.2) * 2.0 + 3.0 * np.tanh(1.0) + 0.7 * 0.005
    for kind, expected in (("none", 0.0), ("gravity", gravity), ("nominal", nominal)):
        np.testing.assert_allclose(
            feedforward(arm, RigidBody(arm), kind, q, dq, ddq), [[expected]], rtol=1e-12
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
    body = nominal.changed(change)
    q, dq, ddq = rng.standard_normal((3, 2, 7))
    by_position, by_velocity, mass = body.sensitivities(q, dq, ddq)
    for j, step in enumerate(STEP * np.eye(7)):
        for derivative, along in (
            (by_position, (step, 0, 0)),
            (by_velocity, (0, step, 0)),
            (mass, (0, 0, step)),
        ):
            ahead = body.inverse_dynamics(q + along[0], dq + along[1], ddq + along[2])
            behind = body.inverse_dynamics(q - along[0], dq - along[1], ddq - along[2])
            central = (ahead - behind) / (2 * STEP)
            assert derivative[:, :, j] == pytest.approx(central, abs=1e-5)
