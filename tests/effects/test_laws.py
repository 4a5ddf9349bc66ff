"""Golden values of every law, worked out by hand, never by the law's own formula."""

from dataclasses import replace

import numpy as np
import pytest
from arms import ROD, chain

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import point_mass_parameters
from gapscope.arm.motions.motion import Motion
from gapscope.effects import (
    actuation,
    environment,
    friction,
    rigid_body,
    sensing,
    transmission,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE, effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw, Path, Signals
from gapscope.effects.series import MotionSeries

ONE = np.array([1.0])


def _signals(
    velocity: float = 0.0, position: float = 0.0, load: float = 0.0, t: float = 0.0
) -> Signals:
    return Signals(t, np.array([position]), np.array([velocity]), np.array([load]))


GOLDEN = [
    # tanh(0.005 / 0.005) = 0.761594
    ("coulomb", friction.coulomb(_signals(velocity=0.005), np.array([4.0])), 3.046377),
    (
        "coulomb, backwards",
        friction.coulomb(_signals(velocity=-1.0), np.array([4.0])),
        -4.0,
    ),
    ("viscous", friction.viscous(_signals(velocity=-0.5), np.array([14.5])), -7.25),
    # at v = vs the peak has fallen to 1 / e
    (
        "stribeck",
        friction.stribeck(_signals(velocity=0.2), np.array([3.0]), np.array([0.2])),
        1.103638,
    ),
    (
        "stribeck, sliding",
        friction.stribeck(_signals(velocity=2.0), np.array([3.0]), np.array([0.2])),
        0.0,
    ),
    # at v = vs tanh 1 = 0.761594 of the level, far above all of it, at a tenth of vs about a tenth (tanh 0.1)
    (
        "saturating",
        friction.saturating(_signals(velocity=-0.5), np.array([4.0]), np.array([0.5])),
        -3.046377,
    ),
    (
        "saturating, fast",
        friction.saturating(_signals(velocity=9.0), np.array([4.0]), np.array([0.5])),
        4.0,
    ),
    (
        "saturating, slow",
        friction.saturating(_signals(velocity=0.1), np.array([4.0]), np.array([1.0])),
        0.398672,
    ),
    (
        "saturating, off",
        friction.saturating(_signals(velocity=1.0), np.array([4.0]), np.array([0.0])),
        0.0,
    ),
    # tau = 10 + 0.2 tau: 12.5 when driving; tau = 10 - 0.2 tau: 8.333 when driven
    (
        "load, driving",
        friction.load_dependent(_signals(velocity=1.0, load=10.0), np.array([0.2])),
        2.5,
    ),
    (
        "load, driven",
        friction.load_dependent(_signals(velocity=-1.0, load=10.0), np.array([0.2])),
        -1.666667,
    ),
    # 1 + 0.6 / e
    ("drift", friction.drift_change(30.0, np.array([0.6]), np.array([30.0])), 0.220728),
    (
        "spring",
        transmission.spring(_signals(position=0.7), np.array([20.0]), np.array([0.2])),
        10.0,
    ),
    (
        "elastic torque",
        transmission.elastic_torque(0.002 * ONE, -0.1 * ONE, 1e4 * ONE, 30.0 * ONE),
        17.0,
    ),
    (
        "elastic deflection",
        transmission.elastic_deflection(50.0 * ONE, 1e4 * ONE, 30.0 * ONE),
        0.005,
    ),
    (
        "backlash deflection",
        transmission.backlash_deflection(-3.0 * ONE, 0.01 * ONE),
        -0.005,
    ),
    (
        "through backlash",
        transmission.through_backlash(-0.012 * ONE, 0.02 * ONE),
        -0.002,
    ),
    ("inside backlash", transmission.through_backlash(0.009 * ONE, 0.02 * ONE), 0.0),
    # 2 sin(6 * 15 deg) and 2 sin(6 * 15 deg + 30 deg)
    (
        "ripple",
        actuation.ripple_torque(np.deg2rad([15.0]), 2.0 * ONE, 6.0 * ONE, 0.0 * ONE),
        2.0,
    ),
    (
        "ripple, shifted",
        actuation.ripple_torque(
            np.deg2rad([15.0]), 2.0 * ONE, 6.0 * ONE, np.pi / 6 * ONE
        ),
        1.732051,
    ),
    ("scale", actuation.scale(8.0 * ONE, None, 0.25 * ONE), 10.0),
    ("offset", actuation.offset(8.0 * ONE, None, -3.5 * ONE), 4.5),
    ("saturation", actuation.saturate(-90.0 * ONE, None, 40.0 * ONE), -40.0),
    ("no saturation", actuation.saturate(-90.0 * ONE, None, 0.0 * ONE), -90.0),
    ("encoder offset", sensing.add_offset(0.5 * ONE, 0.02 * ONE), 0.52),
    ("quantization", sensing.quantize(0.52 * ONE, 0.05 * ONE), 0.5),
    ("no quantization", sensing.quantize(0.52 * ONE, 0.0 * ONE), 0.52),
    ("force acts", environment.acts(2.5, 2.0 * ONE, 3.0 * ONE), 1.0),
    ("force is over", environment.acts(3.0, 2.0 * ONE, 3.0 * ONE), 0.0),
]


@pytest.mark.parametrize(
    ("name", "value", "expected"), GOLDEN, ids=[name for name, *_ in GOLDEN]
)
def test_golden_value(name: str, value: np.ndarray, expected: float) -> None:
    assert float(value[0]) == pytest.approx(expected, abs=2e-6)


def test_tilt_by_hand() -> None:
    """Rolled by 90 deg about x, gravity points along -y of the base; pitched by 90 deg about y, along +x."""
    gravity = np.array([0.0, 0.0, -9.81])
    np.testing.assert_allclose(
        environment.tilt(np.pi / 2, 0.0).T @ gravity, [0, -9.81, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        environment.tilt(0.0, np.pi / 2).T @ gravity, [9.81, 0, 0], atol=1e-12
    )


def test_point_mass_by_hand() -> None:
    """2 kg at (0.1, 0, 0.3) m: Ixx = 2 * 0.09, Iyy = 2 * 0.1, Izz = 2 * 0.01, Ixz = -2 * 0.03 kg m^2."""
    expected = [2.0, 0.2, 0.0, 0.6, 0.18, 0.0, 0.2, -0.06, 0.0, 0.02]
    np.testing.assert_allclose(
        point_mass_parameters(2.0, np.array([0.1, 0.0, 0.3])), expected, atol=1e-15
    )


def test_link_error_by_hand() -> None:
    """4 kg, I = diag(1, 2, 3) about (0.5, 0, 0), gains 25 % and moves by 0.1 m in x: 5 kg at 0.6 m, I = 1.25 I."""
    own = np.array([4.0, 2.0, 0, 0, 1.0, 0, 2.0 + 1.0, 0, 0, 3.0 + 1.0])
    new = own + rigid_body.link_change(
        own, np.array(2.0), np.array(1.0), np.array([0.1, 0.0, 0.0])
    )
    np.testing.assert_allclose(
        new, [5.0, 3.0, 0, 0, 1.25, 0, 2.5 + 1.8, 0, 0, 3.75 + 1.8], atol=1e-12
    )


def test_law_is_amplitude_times_direction_where_the_load_is_known() -> None:
    rng = np.random.default_rng(0)
    for law in (e for e in CATALOGUE.values() if isinstance(e, DryLaw)):
        values = [
            rng.uniform(*np.clip(p.typical, 0, 0.5), 6) + 0.01 for p in law.parameters
        ]
        velocity, load = rng.normal(size=6), 10 * rng.normal(size=6)
        torque = law.law(Signals(0.0, velocity, velocity, load), *values)
        motor = load + torque if law.name == "load_friction" else load
        np.testing.assert_allclose(
            torque,
            law.amplitude(velocity, motor, *values) * np.tanh(velocity / 0.005),
            rtol=1e-9,
        )


@pytest.fixture
def sine() -> Motion:
    """One joint that moves as 0.5 sin(2 t)."""
    t = np.arange(0.0, 6.0, 1e-3)
    x = 2 * t[:, None]
    return Motion(t, 0.5 * np.sin(x), np.cos(x), -2 * np.sin(x))


@pytest.mark.parametrize(
    "path", [e for e in CATALOGUE.values() if isinstance(e, Path)], ids=lambda e: e.name
)
def test_inverse_undoes_what_is_applied(path: Path, sine: Motion) -> None:
    values = {
        "torque_saturation": (50.0,),
        "actuator_delay": (0.02,),
        "actuator_lag": (0.03,),
        "torque_scale": (-0.2,),
        "torque_offset": (3.0,),
        "torque_ripple": (2.0, 7.0, 0.3),
    }[path.name]
    series, torque = MotionSeries(sine), 10.0 * np.sin(5 * sine.t)[:, None]
    arrays = [np.array([v]) for v in values]
    applied = path.applied(torque, series, *arrays)
    assert path.name == "torque_saturation" or np.abs(applied - torque).max() > 0.5
    np.testing.assert_allclose(
        path.inverse(applied, series, *arrays)[100:-100], torque[100:-100], atol=2e-4
    )


def test_lag_of_a_ramp_trails_by_its_time_constant(sine: Motion) -> None:
    """A ramp behind 1 / (1 + T s) is the ramp T later, once settled."""
    ramp = 3.0 * sine.t[:, None]
    np.testing.assert_allclose(
        MotionSeries(sine).lagged(ramp, np.array([0.05]))[1000:],
        ramp[1000:] - 0.15,
        atol=1e-7,
    )


def test_force_on_the_last_link_by_hand(tmp_path) -> None:
    """Rod along x, centre of mass at 0.5 m, hinge about y: 10 N upwards turn it by r x f = -5 N m."""
    arm = chain(tmp_path, "rod", ROD)
    body = RigidBody(arm)
    assert body.force_torque(
        np.zeros((1, 1)), np.array([0.0, 0.0, 10.0])
    ) == pytest.approx(-5.0)
    force = AppliedEffect(
        "external_force", (), {"force": [0.0, 0.0, 10.0], "start": 1.0, "end": 2.0}
    )
    t = np.arange(0.0, 3.0, 0.01)
    still = np.zeros((len(t), 1))
    torque = CorrectedArm(arm, (force,)).predict(body, Motion(t, still, still, still))
    assert torque[50, 0] == pytest.approx(-9.81) and torque[150, 0] == pytest.approx(
        -9.81 + 5.0
    )
    turned = replace(arm, gravity=np.zeros(3))
    tilt = AppliedEffect("base_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
    torque = CorrectedArm(turned, (force, tilt)).predict(
        body.changed(np.zeros((1, 10)), np.zeros(3)), Motion(t, still, still, still)
    )
    assert torque[150, 0] == pytest.approx(
        0.0, abs=1e-9
    )  # the rod now points down, along the force


def test_unknown_name_offers_the_nearest() -> None:
    with pytest.raises(InputError, match="unknown effect 'joint_elastcity'") as caught:
        effect("joint_elastcity")
    assert "did you mean joint_elasticity?" in caught.value.remedy
