"""Each law against values worked out by hand, and the payload against a body that pinocchio welds on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import point_mass_parameters
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Signals


def one(q: float = 0.0, dq: float = 0.0, ddq: float = 0.0) -> Motion:
    """One joint for a second with constant q, dq and ddq, as if a camera saw one instant all the time."""
    t = np.arange(11) / 10
    return Motion(t, *(np.full((11, 1), x) for x in (q, dq, ddq)))


def torque(arm: NominalArm, motion: Motion, *effects: AppliedEffect) -> float:
    """Predicted torque in the middle of a motion of one joint."""
    return float(CorrectedArm(arm, effects).predict(RigidBody(arm), motion)[5, 0])


def applied(name: str, **values: float) -> AppliedEffect:
    return AppliedEffect(
        name, (1,), {key: np.array([value]) for key, value in values.items()}
    )


# the pendulum's nominal torque is 0.55 ddq - 9.81 cos q: 0 at q = pi/2, -9.81 at q = 0, and 0.55 * 20 = 11 more
UPRIGHT = np.pi / 2
GOLDEN = [
    ("coulomb_friction", {"torque": 2.0}, one(UPRIGHT, dq=1.0), 2.0),
    ("coulomb_friction", {"torque": 2.0}, one(UPRIGHT, dq=-1.0), -2.0),
    (
        "coulomb_friction",
        {"torque": 2.0},
        one(UPRIGHT, dq=0.005),
        2.0 * 0.7615941559557649,
    ),  # tanh 1
    ("coulomb_friction", {"torque": 2.0}, one(UPRIGHT), 0.0),
    ("viscous_friction", {"coefficient": 3.0}, one(UPRIGHT, dq=-0.5), -1.5),
    (
        "saturating_friction",
        {"torque": 2.0, "velocity": 0.5},
        one(UPRIGHT, dq=0.25),
        2.0 * 0.46211715726000973,
    ),  # tanh 0.5
    (
        "load_friction",
        {"coefficient": 0.25},
        one(0.0, dq=1.0),
        -9.81 / 1.25,
    ),  # helped by gravity: tau + 0.25|tau|
    ("load_friction", {"coefficient": 0.25}, one(0.0, dq=-1.0), -9.81 / 0.75),
    ("load_friction", {"coefficient": 0.25}, one(np.pi, dq=1.0), 9.81 / 0.75),
    ("load_friction", {"coefficient": 0.25}, one(np.pi, dq=-1.0), 9.81 / 1.25),
    ("load_friction", {"coefficient": 0.25}, one(0.0), -9.81),
    ("armature", {"inertia": 0.4}, one(UPRIGHT, ddq=20.0), 11.0 + 8.0),
    ("armature", {"inertia": 0.4}, one(UPRIGHT, dq=2.0), 0.0),
    ("torque_scale", {"scale": 0.2}, one(0.0), -9.81 / 1.2),
    ("torque_scale", {"scale": -0.25}, one(UPRIGHT, ddq=20.0), 11.0 / 0.75),
    ("torque_offset", {"torque": 1.5}, one(0.0), -9.81 - 1.5),
    ("torque_offset", {"torque": -1.5}, one(UPRIGHT), 1.5),
    ("actuator_delay", {"delay": 0.02}, one(0.0), -9.81),
    (
        "encoder_offset",
        {"offset": 0.3},
        one(0.3),
        -9.81,
    ),  # 0.3 rad are read where the rod is level
    (
        "encoder_offset",
        {"offset": -0.3},
        one(0.3),
        -9.81 * 0.8253356149096783,
    ),  # cos 0.6
    ("encoder_offset", {"offset": 0.3}, one(0.3 + UPRIGHT, ddq=20.0), 11.0),
]


@pytest.mark.parametrize(("name", "values", "motion", "expected"), GOLDEN)
def test_torque_of_a_pendulum(
    pendulum: NominalArm,
    name: str,
    values: dict[str, float],
    motion: Motion,
    expected: float,
) -> None:
    assert torque(pendulum, motion, applied(name, **values)) == pytest.approx(
        expected, abs=1e-9
    )


def test_delay_moves_a_sine_forward_by_its_delay(pendulum: NominalArm) -> None:
    """Recorded(t) = needed(t + T): sin(2 pi t) comes as sin(2 pi t + 0.1 pi) with T = 50 ms."""
    t = np.arange(501) / 250
    zero = np.zeros((501, 1))
    needed = np.sin(2 * np.pi * t)[:, None]
    delayed = CorrectedArm(
        pendulum, (applied("actuator_delay", delay=0.05),)
    ).recorded_torque(needed, Motion(t, zero, zero, zero))
    np.testing.assert_allclose(
        delayed[:480, 0], np.sin(2 * np.pi * t + 0.1 * np.pi)[:480], atol=1e-6
    )
    np.testing.assert_allclose(
        delayed[-1], needed[-1], atol=1e-9
    )  # nothing is known beyond the end


def signals(velocity: float, load: float) -> Signals:
    """One sample of one joint at the origin."""
    return Signals(0.0, np.zeros(1), np.array([velocity]), np.array([load]))


@pytest.mark.parametrize("mu", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("load", [-30.0, -1.0, 0.0, 12.0])
@pytest.mark.parametrize("direction", [-1.0, 0.0, 1.0])
def test_load_friction_solves_its_own_equation(
    mu: float, load: float, direction: float
) -> None:
    """tau = load + mu |tau| sgn v, found here by iterating, which converges as mu < 1."""
    tau = load
    for _ in range(300):
        tau = load + mu * abs(tau) * direction
    law = effect("load_friction").law(signals(direction, load), np.array([mu]))
    np.testing.assert_allclose(law, tau - load, atol=1e-9)


def test_point_mass_parameters() -> None:
    """2 kg at (1, 2, 3): I = m (c.c E - c c^T) in the order m, mc, Ixx Ixy Iyy Ixz Iyz Izz."""
    expected = [2, 2, 4, 6, 2 * 13, -2 * 2, 2 * 10, -2 * 3, -2 * 6, 2 * 5]
    np.testing.assert_allclose(
        point_mass_parameters(2.0, np.array([1.0, 2.0, 3.0])), expected
    )


def test_payload_of_a_pendulum(pendulum: NominalArm) -> None:
    """1 kg at 0.4 m: gravity torque -1 * 9.81 * 0.4, inertia 0.16 kg m^2."""
    load = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.4, 0.0, 0.0]})
    assert torque(pendulum, one(0.0), load) == pytest.approx(-9.81 - 3.924)
    assert torque(pendulum, one(UPRIGHT, ddq=10.0), load) == pytest.approx(5.5 + 1.6)


@pytest.mark.parametrize("order", [("yaw", "pitch"), ("pitch", "yaw")])
def test_payload_equals_a_welded_body(
    two: NominalArm, motion: Motion, order: tuple[str, str]
) -> None:
    """Against pinocchio's own model with the mass appended, whatever the order of the columns."""
    columns = [("yaw", "pitch").index(name) for name in order]
    arm = NominalArm("two", two.urdf, order)
    mass, com = 1.7, np.array([0.3, -0.1, 0.2])
    model = pin.buildModelFromUrdf(str(two.urdf))
    model.appendBodyToJoint(
        2, pin.Inertia(mass, com, np.zeros((3, 3))), pin.SE3.Identity()
    )
    data = model.createData()
    rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
    welded = np.array([pin.rnea(model, data, *row) for row in rows])[:, columns]
    seen = Motion(
        motion.t, motion.q[:, columns], motion.dq[:, columns], motion.ddq[:, columns]
    )
    load = AppliedEffect("payload", (), {"mass": mass, "com": com})
    np.testing.assert_allclose(
        CorrectedArm(arm, (load,)).predict(RigidBody(arm), seen), welded, atol=1e-9
    )


@given(
    velocity=st.floats(-10, 10),
    load=st.floats(-100, 100),
    name=st.sampled_from(["coulomb_friction", "viscous_friction", "load_friction"]),
    part=st.floats(0, 1),
)
def test_friction_takes_energy_and_is_odd(
    velocity: float, load: float, name: str, part: float
) -> None:
    """law(v) v >= 0 with the load, and turning the world round turns the torque round."""
    definition = effect(name)
    value = part * definition.parameters[0].bounds[1]
    forth, back = (
        definition.law(signals(s * velocity, s * load), value)[0] for s in (1, -1)
    )
    assert forth * velocity >= 0
    assert forth == pytest.approx(-back)
