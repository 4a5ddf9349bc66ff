"""The simulated arm on PyBullet against pinocchio, conservation laws and hand-worked cases."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.simulated_arm import SimulatedArm

PAYLOAD = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.05, 0.02, 0.1]})

TOOL = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.0, 0.1]})


def _accelerations(engine: SimulatedArm, rng: np.random.Generator, samples: int = 40):
    """Random states, torques and the accelerations that the engine makes of them."""
    for _ in range(samples):
        q, dq = (
            rng.uniform(-1.5, 1.5, engine.arm.n_joints),
            rng.uniform(-2, 2, engine.arm.n_joints),
        )
        torque = rng.uniform(-40, 40, engine.arm.n_joints)
        engine.reset(q, dq)
        engine.step(torque)
        yield q, dq, torque, (engine.dq - dq) / engine.dt


def _loaded_model(arm: NominalArm) -> pin.Model:
    """The arm with the payload welded on, by pinocchio's own means."""
    model = pin.buildModelFromUrdf(str(arm.urdf))
    inertia = pin.Inertia(
        float(PAYLOAD.parameters["mass"]), PAYLOAD.parameters["com"], np.zeros((3, 3))
    )
    model.appendBodyToJoint(7, inertia, pin.SE3.Identity())
    return model


def test_without_effects_it_is_pinocchios_inverse_dynamics(
    bare_arm: NominalArm,
) -> None:
    body = RigidBody(bare_arm)
    with SimulatedArm(bare_arm) as engine:
        for q, dq, torque, ddq in _accelerations(engine, np.random.default_rng(1)):
            np.testing.assert_allclose(
                body.inverse_dynamics(q[None], dq[None], ddq[None])[0],
                torque,
                atol=1e-9,
            )


def test_payload_is_the_inverse_dynamics_of_the_loaded_model(
    bare_arm: NominalArm,
) -> None:
    model = _loaded_model(bare_arm)
    data = model.createData()
    with SimulatedArm(bare_arm, (PAYLOAD,)) as engine:
        for q, dq, torque, ddq in _accelerations(engine, np.random.default_rng(2)):
            np.testing.assert_allclose(
                pin.rnea(model, data, q, dq, ddq), torque, atol=1e-9
            )


def test_armature_adds_to_the_mass_matrix(
    data_sheet_arm: NominalArm, bare_arm: NominalArm
) -> None:
    arm = replace(bare_arm, armature=data_sheet_arm.armature)
    extra = AppliedEffect("armature", (2, 6), {"inertia": [0.7, 0.05]})
    total = arm.armature + extra.per_joint("inertia", 7)
    body = RigidBody(arm)
    with SimulatedArm(arm, (extra,)) as engine:
        for q, dq, torque, ddq in _accelerations(engine, np.random.default_rng(3)):
            expected = np.linalg.solve(
                body.mass_matrix(q) + np.diag(total), torque - body.bias(q, dq)
            )
            np.testing.assert_allclose(ddq, expected, rtol=1e-9, atol=1e-9)


def _energy(engine: SimulatedArm) -> tuple[float, float]:
    model = engine.body.model
    data = model.createData()
    return pin.computeKineticEnergy(
        model, data, engine.q, engine.dq
    ), pin.computePotentialEnergy(model, data, engine.q)


@pytest.mark.parametrize("effects", [(), (TOOL,)])
@pytest.mark.parametrize(("dt", "allowed"), [(1e-3, 0.01), (2.5e-4, 0.0025)])
def test_free_swing_keeps_its_energy(
    bare_arm: NominalArm,
    tmp_path: Path,
    effects: tuple[AppliedEffect, ...],
    dt: float,
    allowed: float,
) -> None:
    """Hanging, 2.5 s, 6 rad/s: the error is of first order in dt, 0.54 % of the greatest kinetic energy at 1 ms."""
    free = tmp_path / "free.urdf"  # without limits: the wrist swings past them
    free.write_text(
        bare_arm.urdf.read_text().replace('type="revolute"', 'type="continuous"')
    )
    hanging = replace(bare_arm, urdf=free, gravity=np.array([0.0, 0.0, 9.81]))
    with SimulatedArm(hanging, effects, dt) as engine:
        engine.reset(np.array([0.15, 0.2, 0.1, -0.25, 0.05, 0.2, 0.0]))
        start = sum(_energy(engine))
        energies = []
        for _ in range(int(2.5 / dt)):
            engine.step(np.zeros(7))
            energies.append(_energy(engine))
    kinetic, potential = np.array(energies).T
    assert np.abs(kinetic + potential - start).max() < allowed * kinetic.max()


def test_friction_holds_the_arm_on_a_slope(data_sheet_arm: NominalArm) -> None:
    """Gravity below Coulomb friction at every joint: not a step of drift, not a trace of chatter."""
    arm = replace(data_sheet_arm, coulomb=np.full(7, 60.0))
    q = np.array([0.2, 0.5, -0.3, -0.9, 0.3, 0.6, 0.1])
    with SimulatedArm(arm) as engine:
        engine.reset(q)
        speeds = []
        for _ in range(1000):
            engine.step(np.zeros(7))
            speeds.append(np.abs(engine.dq).max())
        assert max(speeds) < 1e-9
        np.testing.assert_allclose(engine.q, q, atol=1e-9)


def test_friction_stops_a_moving_joint_and_never_turns_it_round(pendulum) -> None:
    """0.55 kg m^2 at 1 rad/s against 11 N m without gravity: stops after 0.05 s and 0.025 rad, and stays."""
    arm = replace(pendulum(coulomb=11.0), gravity=np.zeros(3))
    with SimulatedArm(arm) as engine:
        engine.reset(np.zeros(1), np.ones(1))
        path = []
        for _ in range(200):
            engine.step(np.zeros(1))
            path.append((float(engine.q[0]), float(engine.dq[0])))
    position, speed = np.array(path).T
    assert speed.min() > -1e-9 and np.abs(speed[51:]).max() < 1e-9
    assert position[-1] == pytest.approx(0.025, abs=6e-4)


@pytest.mark.parametrize(
    ("torque", "moves"), [(19.0, 0), (20.2, 1), (7.0, 0), (6.0, -1)]
)
def test_load_friction_sticks_up_to_its_share_of_the_motor_torque(
    pendulum, torque: float, moves: int
) -> None:
    """mu = 0.5 under a gravity torque of 9.81 N m: up beyond 9.81 / (1 - mu), down below 9.81 / (1 + mu) N m."""
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.5]})
    with SimulatedArm(pendulum(), (friction,)) as engine:
        for _ in range(100):
            engine.step(np.array([-torque]))
        assert (-np.sign(engine.q[0]) if abs(engine.q[0]) > 1e-6 else 0) == moves


def test_viscous_friction_limits_the_speed(pendulum) -> None:
    arm = replace(pendulum(viscous=4.0), gravity=np.zeros(3))
    with SimulatedArm(
        arm, (AppliedEffect("viscous_friction", (1,), {"coefficient": [1.0]}),)
    ) as engine:
        for _ in range(2000):
            engine.step(np.array([10.0]))
        assert engine.dq[0] == pytest.approx(2.0, rel=1e-6)


def test_delay_shifts_the_response(bare_arm: NominalArm) -> None:
    delay = AppliedEffect("actuator_delay", (1,), {"delay": [0.01]})
    torque = np.zeros(7)
    with SimulatedArm(bare_arm, (delay,)) as engine:
        engine.step(torque)
        torque[0] = 5.0
        speeds = []
        for _ in range(12):
            engine.step(torque)
            speeds.append(abs(engine.dq[0]))
    assert max(speeds[:10]) < 1e-3 < speeds[10]


def test_joint_limits_hold_under_gravity(bare_arm: NominalArm) -> None:
    _, upper = RigidBody(bare_arm).position_limits()
    with SimulatedArm(bare_arm) as engine:
        engine.reset(np.array([0.0, 0.4, 0.0, 0.3, 0.0, 0.3, 0.0]))
        worst = 0.0
        for _ in range(3000):
            engine.step(np.zeros(7))
            worst = max(worst, (np.abs(engine.q) - upper).max())
    assert 0.0 < worst < 0.02


def test_worlds_do_not_disturb_each_other(bare_arm: NominalArm) -> None:
    with SimulatedArm(bare_arm) as first, SimulatedArm(bare_arm, (PAYLOAD,)) as second:
        for _ in range(10):
            first.step(np.zeros(7))
            second.step(np.zeros(7))
        with SimulatedArm(bare_arm) as alone:
            for _ in range(10):
                alone.step(np.zeros(7))
            np.testing.assert_array_equal(first.q, alone.q)
        assert np.abs(second.q - first.q).max() > 1e-6


def test_close_may_be_called_twice(bare_arm: NominalArm) -> None:
    engine = SimulatedArm(bare_arm)
    engine.close()
    engine.close()


def test_negative_total_friction_is_refused(data_sheet_arm: NominalArm) -> None:
    with pytest.raises(InputError, match="joint 3"):
        SimulatedArm(
            data_sheet_arm,
            (AppliedEffect("coulomb_friction", (3,), {"torque": [-9.0]}),),
        )


def test_massless_link_is_refused(pendulum_urdf: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.urdf"
    text = pendulum_urdf.read_text()
    broken.write_text(
        text[: text.index("<inertial>")] + text[text.index("</inertial>") + 11 :]
    )
    with pytest.raises(
        InputError, match=r"broken.urdf: the link moved by joint 1 \(hinge\) has mass 0"
    ):
        SimulatedArm(NominalArm("broken", broken, ("hinge",)))


def test_payload_that_leaves_a_negative_mass_is_refused(bare_arm: NominalArm) -> None:
    less = AppliedEffect(
        "payload", (), {"mass": -0.5, "com": [0.0, 0.0, 0.0]}
    )  # the last link has 0.3 kg
    with pytest.raises(
        InputError, match=r"payload: the link moved by joint 7 \(.*\) has mass -0\.2 kg"
    ):
        SimulatedArm(bare_arm, (less,))


@pytest.mark.parametrize("moments", ["0.4 0.05 0.05 0.02", "0.05 0.05 0.4 0.01"])
def test_inertia_that_pybullet_would_zero_is_kept(
    pendulum_urdf: Path, tmp_path: Path, moments: str
) -> None:
    """Moments that break the triangle inequality, as CAD exports have them, and off-diagonal ones."""
    ixx, iyy, izz, ixy = moments.split()
    old = 'ixx="0.01" iyy="0.05" izz="0.05" ixy="0"'
    file = tmp_path / "odd.urdf"
    file.write_text(
        pendulum_urdf.read_text().replace(
            old, f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}"'
        )
    )
    arm = NominalArm("odd", file, ("hinge",))
    body = RigidBody(arm)
    with SimulatedArm(arm) as engine:
        for q, dq, torque, ddq in _accelerations(engine, np.random.default_rng(4), 5):
            np.testing.assert_allclose(
                body.inverse_dynamics(q[None], dq[None], ddq[None])[0],
                torque,
                atol=1e-9,
            )


def test_columns_in_another_order_and_locked_joints(bare_arm: NominalArm) -> None:
    """Five of the seven joints, backwards: the others are locked and their mass stays."""
    arm = NominalArm("part", bare_arm.urdf, tuple(reversed(bare_arm.joints[:5])))
    body = RigidBody(arm)
    with SimulatedArm(arm) as engine:
        for q, dq, torque, ddq in _accelerations(engine, np.random.default_rng(5), 10):
            np.testing.assert_allclose(
                body.inverse_dynamics(q[None], dq[None], ddq[None])[0],
                torque,
                atol=1e-9,
            )
