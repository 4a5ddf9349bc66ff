"""Bodies behind springs and free play, against closed solutions of one joint and a simulation of two."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from arms import ROD, chain
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.deflection import (
    CALM,
    through_play,
    through_springs,
)
from gapscope.model.conditioning import low_pass

INERTIA = 2.0 * 0.5**2 + 0.05
"""Of the pendulum about its axis [kg m^2]."""
RATE = 1000.0


@pytest.fixture
def swing(pendulum: NominalArm) -> RigidBody:
    """The pendulum; its gravity torque is -9.81 cos q."""
    return RigidBody(pendulum)


@pytest.fixture
def turntable(tmp_path: Path) -> RigidBody:
    """The same rod about a vertical axis: tau = J ddq and nothing else."""
    return RigidBody(chain(tmp_path, "turntable", ROD._replace(axis="0 0 1")))


def sine(
    frequency: float, amplitude: float = 0.1, duration: float = 4.0, rate: float = RATE
) -> Motion:
    """A motor that swings, from rest within half a second [Hz, rad, s]."""
    t, w = np.arange(int(duration * rate)) / rate, 2 * np.pi * frequency
    x = np.clip(t / 0.5, 0, 1)
    rise = x**3 * (10 - 15 * x + 6 * x**2)
    slope, bend = 60 * x**2 * (1 - x) ** 2, 240 * x * (1 - x) * (1 - 2 * x)
    wave, across = np.sin(w * t), w * np.cos(w * t)
    q, dq = rise * wave, slope * wave + rise * across
    ddq = bend * wave + 2 * slope * across - rise * w**2 * wave
    return Motion(t, *(amplitude * part[:, None] for part in (q, dq, ddq)))


def rigid(body: RigidBody, motion: Motion) -> np.ndarray:
    return body.inverse_dynamics(motion.q, motion.dq, motion.ddq)


def behind(
    law: Callable[..., np.ndarray], body: RigidBody, motion: Motion, *gear: list[float]
) -> np.ndarray:
    """Torque of the bodies behind springs or free play, whose values are given for each joint."""
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return law(matrices, motion, rigid(body, motion), *map(np.array, gear))


def behind_play(
    body: RigidBody, motion: Motion, width: float, stiffness: float = 0.0
) -> np.ndarray:
    return behind(through_play, body, motion, [width], [stiffness], [0.0])


def phasor(series: np.ndarray, motion: Motion, frequency: float) -> complex:
    """Amplitude of e^{i w t} in the second half of a series."""
    late = motion.t > motion.t[-1] / 2
    wave = np.exp(2j * np.pi * frequency * motion.t[late])
    basis = np.column_stack([wave.real, wave.imag])
    a, b = np.linalg.lstsq(basis, series[late, 0], rcond=None)[0]
    return complex(a, b).conjugate()


NATURAL = 8.0
"""Frequency of the link on its spring [Hz]."""


@pytest.mark.parametrize("ratio", [0.25, 0.9, 1.0, 1.1, 2.5])
@pytest.mark.parametrize("zeta", [0.05, 0.3])
def test_response_of_a_spring(turntable: RigidBody, ratio: float, zeta: float) -> None:
    """Link over motor: (k + i d w) / (k - J w^2 + i d w), below, at and above the resonance."""
    k = INERTIA * (2 * np.pi * NATURAL) ** 2
    d = 2 * zeta * np.sqrt(k * INERTIA)
    frequency = ratio * NATURAL
    w = 2 * np.pi * frequency
    expected = (k + 1j * d * w) / (k - INERTIA * w**2 + 1j * d * w)
    motion = sine(frequency)
    found = behind(through_springs, turntable, motion, [k], [d])
    gain = phasor(found, motion, frequency)
    gain /= phasor(rigid(turntable, motion), motion, frequency)
    assert abs(gain - expected) < 0.03 * abs(expected)


def test_torque_of_all_joints_follows_the_links(two: NominalArm) -> None:
    """Two joints, the second elastic, against the full equations of motion integrated by ``solve_ivp``."""
    body, k, d = RigidBody(two), 1500.0, 12.0
    one, other = sine(0.8, 0.6, 2.0), sine(1.3, 0.5, 2.0)
    parts = ((one.q, other.q), (one.dq, other.dq), (one.ddq, other.ddq))
    motion = Motion(one.t, *map(np.hstack, parts))
    torque = rigid(body, motion)
    expected = body.inverse_dynamics(*integrated(body, motion, k, d))
    found = behind(through_springs, body, motion, [0.0, k], [0.0, d])
    # past the start, before the one-sided end
    late = (motion.t > 5 * CALM) & (motion.t < motion.t[-1] - 0.01)
    for j in range(2):
        effect = (expected - torque)[late, j]
        assert np.abs(found - expected)[late, j].max() < 0.03 * np.abs(effect).max()


def integrated(
    body: RigidBody, motion: Motion, k: float, d: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion (q, dq, ddq) of two links, the second behind a spring, its motor and the first joint as given."""
    series = np.hstack([motion.q, motion.dq, motion.ddq])

    def acceleration(t: float, x: np.ndarray) -> float:
        driven = np.array([np.interp(t, motion.t, column) for column in series.T])
        theta, rate, bend = driven.reshape(3, 2)
        q, dq = np.array([theta[0], x[0]]), np.array([rate[0], x[1]])
        mass, bias = body.mass_matrix(q), body.bias(q, dq)
        through = k * (theta[1] - x[0]) + d * (rate[1] - x[1])
        return float((through - bias[1] - mass[1, 0] * bend[0]) / mass[1, 1])

    gravity = body.bias(motion.q[0], motion.dq[0])[1]
    solved = solve_ivp(
        lambda t, x: [x[1], acceleration(t, x)],
        (0, motion.t[-1]),
        [motion.q[0, 1] - gravity / k, 0.0],
        t_eval=motion.t,
        rtol=1e-6,
        atol=1e-8,
        max_step=0.01,
    )
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    q[:, 1], dq[:, 1] = solved.y
    states = zip(solved.t, solved.y.T, strict=True)
    ddq[:, 1] = [acceleration(*state) for state in states]
    return q, dq, ddq


@pytest.mark.parametrize("width", [0.01, 0.04])
def test_no_torque_while_the_link_floats(turntable: RigidBody, width: float) -> None:
    """From where the motor slows the link flies on at its speed A w until w t - sin w t = width / A."""
    frequency, amplitude = 1.0, 0.4
    w = 2 * np.pi * frequency
    motion = sine(frequency, amplitude, 3.0)
    torque = rigid(turntable, motion)
    stiffness = INERTIA * (2 * np.pi * 60.0) ** 2
    found = behind_play(turntable, motion, width, stiffness)[:, 0]
    meets = brentq(lambda x: x - np.sin(x) - width / amplitude, 1e-3, np.pi) / w
    # after a whole number of periods the motor is at zero and moves fastest
    since = motion.t - 2.0
    inside = (since > 0.1 * meets) & (since < 0.85 * meets)
    assert np.abs(torque[inside]).max() > 1.0
    assert np.abs(found[inside]).max() < 0.15 * np.abs(torque[inside]).max()
    hit = (since > 0) & (np.abs(found) > 0.5 * np.abs(torque).max())
    assert since[hit][0] == pytest.approx(meets, abs=0.02)


@pytest.mark.parametrize("width", [0.004, 0.02])
def test_a_slow_recording_has_the_same_torque_of_free_play(
    turntable: RigidBody, width: float
) -> None:
    """Within the band of the torque gap sampling at 100 Hz instead of 1000 Hz changes little of what play adds."""
    added = []
    for rate in (1000.0, 100.0):
        motion = sine(1.3, 0.3, rate=rate)
        change = behind_play(turntable, motion, width) - rigid(turntable, motion)
        added.append(low_pass(change, rate, 8.0)[:: round(rate / 100.0), 0])
    often, seldom = (series[20:-20] for series in added)
    assert (seldom - often).std() < 0.2 * often.std()


@pytest.mark.parametrize("angle", [0.7, -0.7])
def test_static_offset_of_free_play(swing: RigidBody, angle: float) -> None:
    """Gravity keeps the gear on one side: the link rests half the free play below the motor."""
    width, k, zero = 0.02, 1e5, np.zeros((int(RATE), 1))
    motion = Motion(np.arange(len(zero)) / RATE, zero + angle, zero, zero)
    torque = rigid(swing, motion)
    assert torque[0, 0] < 0
    settled = (behind_play(swing, motion, width, k) - torque)[int(0.2 * RATE) :]
    link = angle + 0.5 * width - torque[0, 0] / k
    expected = -9.81 * (np.cos(link) - np.cos(angle))
    np.testing.assert_allclose(settled, expected, rtol=0.03)


@pytest.mark.parametrize("seconds", [20.0, 200.0])
def test_links_that_run_away_from_a_soft_spring_leave_a_finite_torque(
    swing: RigidBody, seconds: float
) -> None:
    """An inverted pendulum of 19.6 N m/rad on a spring of 1 N m/rad falls; after 200 s beyond all numbers."""
    t = np.arange(0.0, seconds, 0.01)
    still = np.zeros((len(t), 1))
    motion = Motion(t, still - np.pi / 2, still, still)
    matrices = swing.sensitivities(motion.q, motion.dq, motion.ddq)
    assert matrices[0][0, 0, 0] < -9.0
    pushed = np.full_like(still, 0.1)
    found = through_springs(matrices, motion, pushed, np.ones(1), np.zeros(1))
    assert np.isfinite(found).all() and np.abs(found).max() < 1e4
