"""Golden values of every law, worked out by hand, never by the law's own formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects import (
    actuation,
    environment,
    friction,
    rigid_body,
    sensing,
    transmission,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm, write_corrected
from gapscope.effects.effect import DryLaw, Path, Signals
from gapscope.effects.friction import friction_direction
from gapscope.effects.signals import MotionSeries

ONE = np.array([1.0])


def _law(name: str, *values: float, **known: float) -> np.ndarray:
    """The torque law of an effect, of one sample of one joint."""
    at = Signals(0.0, *(known.get(x, 0.0) * ONE for x in ("position", "velocity")), ONE)
    return CATALOGUE[name].law(at, *(value * ONE for value in values))


def _of(law: Callable[..., np.ndarray], *values: float) -> np.ndarray:
    return law(*(value * ONE for value in values))


def _saturated(torque: float, limit: float) -> np.ndarray:
    return actuation.saturate(torque * ONE, None, limit * ONE)


GOLDEN = [
    # at v = vs the peak has fallen to 1 / e
    ("stribeck", _law("stribeck_friction", 3.0, 0.2, velocity=0.2), 1.103638),
    ("sliding", _law("stribeck_friction", 3.0, 0.2, velocity=2.0), 0.0),
    ("saturating, off", _law("saturating_friction", 4.0, 0.0, velocity=1.0), 0.0),
    # 0.6 / e
    ("drift", _of(friction.drift_change, 30.0, 0.6, 30.0), 0.220728),
    ("spring", _law("parallel_spring", 20.0, 0.2, position=0.7), 10.0),
    ("elastic", _of(transmission.elastic_torque, 0.002, -0.1, 1e4, 30.0), 17.0),
    ("bent", _of(transmission.elastic_deflection, 50.0, 1e4, 30.0), 0.005),
    ("backlash", _of(transmission.backlash_deflection, -3.0, 0.01), -0.005),
    ("through backlash", _of(transmission.through_backlash, -0.012, 0.02), -0.002),
    ("inside backlash", _of(transmission.through_backlash, 0.009, 0.02), 0.0),
    # 2 sin(6 * 15 deg + 30 deg)
    ("ripple", _of(actuation.ripple_torque, np.pi / 12, 2, 6, np.pi / 6), 1.732051),
    ("saturation", _saturated(-90.0, 40.0), -40.0),
    ("no saturation", _saturated(-90.0, 0.0), -90.0),
    ("quantization", _of(sensing.quantize, 0.52, 0.05), 0.5),
    ("no quantization", _of(sensing.quantize, 0.52, 0.0), 0.52),
    ("force acts", _of(environment.acts, 2.5, 2.0, 3.0), 1.0),
    ("force is over", _of(environment.acts, 3.0, 2.0, 3.0), 0.0),
]


@pytest.mark.parametrize(
    ("name", "value", "expected"), GOLDEN, ids=[name for name, *_ in GOLDEN]
)
def test_golden_value(name: str, value: np.ndarray, expected: float) -> None:
    assert float(value[0]) == pytest.approx(expected, abs=2e-6)


def test_tilt_by_hand() -> None:
    """Rolled by 90 deg about x, gravity points along -y of the base; pitched by 90 deg about y, along +x."""
    for turn, expected in (
        ((np.pi / 2, 0), [0, -9.81, 0]),
        ((0, np.pi / 2), [9.81, 0, 0]),
    ):
        found = environment.tilt(*turn).T @ [0.0, 0.0, -9.81]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_link_error_by_hand() -> None:
    """4 kg, I = diag(1, 2, 3) about (0.5, 0, 0), gains 25 % and moves by 0.1 m in x: 5 kg at 0.6 m, I = 1.25 I."""
    own = np.array([4.0, 2.0, 0, 0, 1.0, 0, 2.0 + 1.0, 0, 0, 3.0 + 1.0])
    moved = np.array([0.1, 0.0, 0.0])
    new = own + rigid_body.link_change(own, np.array(2.0), np.array(1.0), moved)
    expected = [5.0, 3.0, 0, 0, 1.25, 0, 2.5 + 1.8, 0, 0, 3.75 + 1.8]
    np.testing.assert_allclose(new, expected, atol=1e-12)


def test_law_is_amplitude_times_direction_where_the_load_is_known() -> None:
    rng = np.random.default_rng(0)
    for law in (e for e in CATALOGUE.values() if isinstance(e, DryLaw)):
        ranges = [np.clip(p.typical, 0, 0.5) + 0.01 for p in law.parameters]
        values = [rng.uniform(*each, 6) for each in ranges]
        velocity, load = rng.normal(size=6), 10 * rng.normal(size=6)
        torque = law.law(Signals(0.0, velocity, velocity, load), *values)
        motor = load + torque if law.name == "load_friction" else load
        expected = law.amplitude(velocity, motor, *values) * np.tanh(velocity / 0.005)
        np.testing.assert_allclose(torque, expected, rtol=1e-9)


T = np.arange(0.0, 6.0, 1e-3)
SINE = sines(T, 0.5, 2.0, np.zeros(1))
"""One joint that moves as 0.5 sin(2 t)."""
ON_THE_WAY = {
    "torque_saturation": (50.0,),
    "actuator_delay": (0.02,),
    "actuator_lag": (0.03,),
    "torque_scale": (-0.2,),
    "torque_offset": (3.0,),
    "torque_ripple": (2.0, 7.0, 0.3),
}


@pytest.mark.parametrize(
    "path", [e for e in CATALOGUE.values() if isinstance(e, Path)], ids=lambda e: e.name
)
def test_inverse_undoes_what_is_applied(path: Path) -> None:
    series, torque = MotionSeries(SINE), 10.0 * np.sin(5 * T)[:, None]
    values = [np.array([value]) for value in ON_THE_WAY[path.name]]
    applied = path.applied(torque, series, *values)
    assert path.name == "torque_saturation" or np.abs(applied - torque).max() > 0.5
    back = path.inverse(applied, series, *values)
    np.testing.assert_allclose(back[100:-100], torque[100:-100], atol=2e-4)


def test_lag_of_a_ramp_trails_by_its_time_constant() -> None:
    """A ramp behind 1 / (1 + T s) is the ramp T later, once settled."""
    ramp = 3.0 * T[:, None]
    lagged = MotionSeries(SINE).lagged(ramp, np.array([0.05]))
    np.testing.assert_allclose(lagged[1000:], ramp[1000:] - 0.15, atol=1e-7)


def test_force_on_the_last_link_by_hand(pendulum: NominalArm) -> None:
    """Rod along x, centre of mass at 0.5 m, hinge about y: 10 N upwards turn it by r x f = -5 N m."""
    acting = {"force": [0.0, 0.0, 10.0], "start": 1.0, "end": 2.0}
    force, t = AppliedEffect("external_force", (), acting), np.arange(0.0, 3.0, 0.01)
    still = Motion(t, *np.zeros((3, len(t), 1)))
    body = RigidBody(pendulum)
    torque = CorrectedArm(pendulum, (force,)).predict(body, still)
    assert torque[[50, 150], 0] == pytest.approx([-9.81, -9.81 + 5.0])
    # the rod now points down, along the force
    tilt = AppliedEffect("base_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
    floating = replace(pendulum, gravity=np.zeros(3))
    body = RigidBody(floating)
    torque = CorrectedArm(floating, (force, tilt)).predict(body, still)
    assert torque[150, 0] == pytest.approx(0.0, abs=1e-9)


# Each law against values worked out by hand.


# the pendulum's nominal torque is 0.55 ddq - 9.81 cos q: 0 at q = pi/2, -9.81 at q = 0, and 0.55 * 20 = 11 more
UPRIGHT = np.pi / 2
OF_PENDULUM = [
    ("coulomb_friction", {"torque": 2.0}, (UPRIGHT, -1.0, 0), -2.0),
    # tanh 1
    ("coulomb_friction", {"torque": 2.0}, (UPRIGHT, 0.005, 0), 2.0 * 0.7615941559557649),
    ("coulomb_friction", {"torque": 2.0}, (UPRIGHT, 0, 0), 0.0),
    ("viscous_friction", {"coefficient": 3.0}, (UPRIGHT, -0.5, 0), -1.5),
    # tanh 0.5
    ("saturating_friction", {"torque": 2.0, "velocity": 0.5}, (UPRIGHT, 0.25, 0), 2.0 * 0.46211715726000973),
    # helped by gravity: tau + 0.25|tau|
    ("load_friction", {"coefficient": 0.25}, (0, 1.0, 0), -9.81 / 1.25),
    ("load_friction", {"coefficient": 0.25}, (0, -1.0, 0), -9.81 / 0.75),
    ("load_friction", {"coefficient": 0.25}, (0, 0, 0), -9.81),
    ("armature", {"inertia": 0.4}, (UPRIGHT, 0, 20.0), 11.0 + 8.0),
    ("torque_scale", {"scale": 0.2}, (0, 0, 0), -9.81 / 1.2),
    ("torque_offset", {"torque": 1.5}, (0, 0, 0), -9.81 - 1.5),
    ("actuator_delay", {"delay": 0.02}, (0, 0, 0), -9.81),
    # 0.3 rad are read where the rod is level
    ("encoder_offset", {"offset": 0.3}, (0.3, 0, 0), -9.81),
    # cos 0.6
    ("encoder_offset", {"offset": -0.3}, (0.3, 0, 0), -9.81 * 0.8253356149096783),
]  # fmt: skip
"""Effect, values, position, velocity and acceleration, which do not change for a second, and torque."""


@pytest.mark.parametrize(("name", "values", "state", "expected"), OF_PENDULUM)
def test_torque_of_a_pendulum(
    pendulum: NominalArm,
    name: str,
    values: dict[str, float],
    state: tuple[float, float, float],
    expected: float,
) -> None:
    motion = Motion(np.arange(11) / 10, *(np.full((11, 1), x) for x in state))
    corrected = CorrectedArm(pendulum, (AppliedEffect(name, (1,), values),))
    torque = corrected.predict(RigidBody(pendulum), motion)
    assert torque[5, 0] == pytest.approx(expected, abs=1e-9)


# Presliding: dry friction that builds up over a distance after each reversal.


COULOMB = AppliedEffect("coulomb_friction", (1,), {"torque": [2.0]})


def direction(path: np.ndarray, distance: float) -> np.ndarray:
    q = path[:, None]
    return friction_direction(q, np.gradient(q, axis=0), np.array([distance]))[:, 0]


# a tenth of a second of rest before
THERE = np.concatenate([np.zeros(10), np.linspace(0.0, 5e-4, 77)])
BACK = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 1.0 - 2e-4, 50)])
RESTS = np.concatenate([np.zeros(9), np.linspace(0, 1e-4, 20), np.full(90, 1e-4)])
BUILT_UP = {
    "exponentially with the distance": (THERE, 0, 1 - np.exp(-THERE / 1e-4)),
    # from s = 1 backwards: s = -1 + 2 exp(-x / z)
    "from where the state was": (BACK, 50, -1 + 2 * np.exp(-(1.0 - BACK[50:]) / 1e-4)),
    "not at rest": (RESTS, 29, np.full(90, 1 - np.exp(-1.0))),
}


@pytest.mark.parametrize("how", BUILT_UP)
def test_friction_builds_up(how: str) -> None:
    path, start, expected = BUILT_UP[how]
    np.testing.assert_allclose(direction(path, 1e-4)[start:], expected, atol=1e-12)


def test_steps_between_the_same_places_do_not_matter() -> None:
    path = 1e-3 * np.cos(np.linspace(0.0, 7.0, 4001))
    fine, coarse = direction(path, 2e-4), direction(path[::4], 2e-4)
    # reversals fall between the coarse samples
    np.testing.assert_allclose(fine[::4], coarse, atol=1e-4)


def test_without_distance_it_is_the_sign_of_the_velocity(pendulum: NominalArm) -> None:
    body, bent = RigidBody(pendulum), replace(pendulum, presliding=[1e-7])
    found, at_once = (
        CorrectedArm(arm, (COULOMB,)).predict(body, SINE) for arm in (bent, pendulum)
    )
    moving = np.abs(SINE.dq[:, 0]) > 0.05
    np.testing.assert_allclose(found[moving], at_once[moving], atol=1e-6)


def test_the_corrected_file_holds_it(pendulum: NominalArm, tmp_path) -> None:
    file = tmp_path / "corrected.yaml"
    write_corrected("case", (COULOMB,), file, presliding=[3e-5])
    assert read_corrected_arm(pendulum, file).arm.presliding == pytest.approx([3e-5])
