"""Bodies behind springs and free play, against closed solutions of one joint and a simulation of two."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
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
NONE = np.zeros(1)


@pytest.fixture
def swing(pendulum: NominalArm) -> RigidBody:
    """The pendulum; its gravity torque is -9.81 cos q."""
    return RigidBody(pendulum)


@pytest.fixture
def turntable(pendulum: NominalArm, tmp_path: Path) -> RigidBody:
    """The same rod about a vertical axis: tau = J ddq and nothing else."""
    urdf = tmp_path / "turntable.urdf"
    urdf.write_text(
        pendulum.urdf.read_text().replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"')
    )
    return RigidBody(NominalArm("turntable", urdf, ("hinge",)))


def sine(
    frequency: float, amplitude: float = 0.1, duration: float = 4.0, rate: float = RATE
) -> Motion:
    """A motor that swings, from rest within half a second [Hz, rad, s]."""
    t, w = np.arange(int(duration * rate)) / rate, 2 * np.pi * frequency
    x = np.clip(t / 0.5, 0, 1)
    rise = x**3 * (10 - 15 * x + 6 * x**2)
    slope, bend = 60 * x**2 * (1 - x) ** 2, 240 * x * (1 - x) * (1 - 2 * x)
    q = rise * np.sin(w * t)
    dq = slope * np.sin(w * t) + rise * w * np.cos(w * t)
    ddq = (
        bend * np.sin(w * t)
        + 2 * slope * w * np.cos(w * t)
        - rise * w**2 * np.sin(w * t)
    )
    return Motion(t, *(amplitude * part[:, None] for part in (q, dq, ddq)))


def rigid(body: RigidBody, motion: Motion) -> np.ndarray:
    return body.inverse_dynamics(motion.q, motion.dq, motion.ddq)


def behind_elasticity(
    body: RigidBody, motion: Motion, torque: np.ndarray, *spring: np.ndarray
) -> np.ndarray:
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return through_springs(matrices, motion, torque, *spring)


def behind_play(
    body: RigidBody, motion: Motion, torque: np.ndarray, *gear: np.ndarray
) -> np.ndarray:
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    return through_play(matrices, motion, torque, *gear)


def at_rest(angle: float, duration: float = 1.0, n: int = 1) -> Motion:
    zero = np.zeros((int(duration * RATE), n))
    return Motion(np.arange(len(zero)) / RATE, zero + angle, zero, zero)


def phasor(series: np.ndarray, motion: Motion, frequency: float) -> complex:
    """Amplitude of e^{i w t} in the second half of a series."""
    late = motion.t > motion.t[-1] / 2
    wave = np.exp(2j * np.pi * frequency * motion.t[late])
    basis = np.column_stack([wave.real, wave.imag])
    a, b = np.linalg.lstsq(basis, series[late], rcond=None)[0]
    return complex(a, b).conjugate()


class TestElasticity:
    NATURAL = 8.0
    """Frequency of the link on its spring [Hz]."""

    def spring(self) -> float:
        return INERTIA * (2 * np.pi * self.NATURAL) ** 2

    @pytest.mark.parametrize("ratio", [0.25, 0.6, 0.9, 1.0, 1.1, 1.5, 2.5])
    @pytest.mark.parametrize("zeta", [0.05, 0.3])
    def test_frequency_response(
        self, turntable: RigidBody, ratio: float, zeta: float
    ) -> None:
        """Link over motor: (k + i d w) / (k - J w^2 + i d w), below, at and above the resonance."""
        k = self.spring()
        d = 2 * zeta * np.sqrt(k * INERTIA)
        frequency = ratio * self.NATURAL
        w = 2 * np.pi * frequency
        expected = (k + 1j * d * w) / (k - INERTIA * w**2 + 1j * d * w)
        motion = sine(frequency)
        torque = rigid(turntable, motion)
        found = behind_elasticity(
            turntable, motion, torque, np.array([k]), np.array([d])
        )
        gain = phasor(found[:, 0], motion, frequency) / phasor(
            torque[:, 0], motion, frequency
        )
        assert abs(gain - expected) < 0.03 * abs(expected)

    def test_torque_of_all_joints_follows_the_links(self, two: NominalArm) -> None:
        """Two joints, the second elastic, against the full equations of motion integrated by ``solve_ivp``."""
        body, k, d = RigidBody(two), 1500.0, 12.0
        one, other = sine(0.8, 0.6, 3.0), sine(1.3, 0.5, 3.0)
        motion = Motion(
            one.t,
            *(
                np.hstack([getattr(m, name) for m in (one, other)])
                for name in ("q", "dq", "ddq")
            ),
        )
        torque = rigid(body, motion)
        links = integrated(body, motion, k, d)
        expected = body.inverse_dynamics(*links)
        found = behind_elasticity(
            body, motion, torque, np.array([0.0, k]), np.array([0.0, d])
        )
        late = (motion.t > 5 * CALM) & (
            motion.t < motion.t[-1] - 0.01
        )  # past the start, before the one-sided end
        for j in range(2):
            effect = (expected - torque)[late, j]
            assert np.abs(found - expected)[late, j].max() < 0.03 * np.abs(effect).max()


def integrated(
    body: RigidBody, motion: Motion, k: float, d: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion (q, dq, ddq) of two links, the second behind a spring, its motor and the first joint as given."""

    def motor(t: float) -> list[np.ndarray]:
        return [
            np.array([np.interp(t, motion.t, series[:, j]) for j in range(2)])
            for series in (motion.q, motion.dq, motion.ddq)
        ]

    def acceleration(t: float, x: np.ndarray) -> float:
        theta, rate, bend = motor(t)
        q, dq = np.array([theta[0], x[0]]), np.array([rate[0], x[1]])
        mass, bias = body.mass_matrix(q), body.bias(q, dq)
        through = k * (theta[1] - x[0]) + d * (rate[1] - x[1])
        return float((through - bias[1] - mass[1, 0] * bend[0]) / mass[1, 1])

    gravity = body.bias(motion.q[0], motion.dq[0])[1]
    start = [motion.q[0, 1] - gravity / k, 0.0]
    solved = solve_ivp(
        lambda t, x: [x[1], acceleration(t, x)],
        (0, motion.t[-1]),
        start,
        t_eval=motion.t,
        rtol=1e-6,
        atol=1e-8,
        max_step=0.01,
    )
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    count = solved.y.shape[1]
    q[:count, 1], dq[:count, 1] = solved.y
    ddq[:count, 1] = [
        acceleration(t, x) for t, x in zip(solved.t, solved.y.T, strict=True)
    ]
    return q, dq, ddq


class TestPlay:
    STIFFNESS = INERTIA * (2 * np.pi * 60.0) ** 2

    def behind(
        self,
        body: RigidBody,
        motion: Motion,
        torque: np.ndarray,
        width: float,
        k: float = 0.0,
    ) -> np.ndarray:
        return behind_play(body, motion, torque, np.array([width]), np.array([k]), NONE)

    @pytest.mark.parametrize("width", [0.01, 0.04])
    def test_no_torque_while_the_link_floats(
        self, turntable: RigidBody, width: float
    ) -> None:
        """From where the motor slows the link flies on at its speed A w until w t - sin w t = width / A."""
        frequency, amplitude = 1.0, 0.4
        w = 2 * np.pi * frequency
        motion = sine(frequency, amplitude, 3.0)
        torque = rigid(turntable, motion)
        found = self.behind(turntable, motion, torque, width, self.STIFFNESS)[:, 0]
        meets = brentq(lambda x: x - np.sin(x) - width / amplitude, 1e-3, np.pi) / w
        begin = 2.0  # a whole number of periods: the motor is at zero and moves fastest
        inside = (motion.t > begin + 0.1 * meets) & (motion.t < begin + 0.85 * meets)
        assert np.abs(torque[inside]).max() > 1.0
        assert np.abs(found[inside]).max() < 0.15 * np.abs(torque[inside]).max()
        impact = motion.t[
            (motion.t > begin) & (np.abs(found) > 0.5 * np.abs(torque).max())
        ][0]
        assert impact - begin == pytest.approx(meets, abs=0.02)

    @pytest.mark.parametrize("width", [0.004, 0.02])
    def test_a_slow_recording_has_the_same_torque(
        self, turntable: RigidBody, width: float
    ) -> None:
        """Within the band of the torque gap sampling at 100 Hz instead of 1000 Hz changes little of what play adds."""
        added = []
        for rate in (1000.0, 100.0):
            motion = sine(1.3, 0.3, rate=rate)
            torque = rigid(turntable, motion)
            change = self.behind(turntable, motion, torque, width) - torque
            slow = low_pass(change, rate, 8.0)
            added.append(slow[:: round(rate / 100.0), 0])
        often, seldom = added
        error = float((seldom - often)[20:-20].std())
        assert error < 0.2 * float(often[20:-20].std())

    @pytest.mark.parametrize("angle", [0.7, -0.7])
    def test_static_offset(self, swing: RigidBody, angle: float) -> None:
        """Gravity keeps the gear on one side: the link rests half the free play below the motor."""
        width, k = 0.02, 1e5
        motion = at_rest(angle)
        torque = rigid(swing, motion)
        assert torque[0, 0] < 0
        found = self.behind(swing, motion, torque, width, k)
        deflection = -0.5 * width + torque[0, 0] / k  # theta - q
        settled = (found - torque)[int(0.2 * RATE) :]
        np.testing.assert_allclose(
            settled, -9.81 * (np.cos(angle - deflection) - np.cos(angle)), rtol=0.03
        )


@pytest.mark.parametrize("seconds", [20.0, 200.0])
def test_links_that_run_away_from_a_soft_spring_leave_a_finite_torque(
    swing: RigidBody, seconds: float
) -> None:
    """An inverted pendulum of 19.6 N m/rad on a spring of 1 N m/rad falls; after 200 s beyond all numbers."""
    t = np.arange(0.0, seconds, 0.01)
    upright = np.full((len(t), 1), np.sign(_stiffness(swing, 1.0)) * -np.pi / 2)
    motion = Motion(t, upright, 0.0 * upright, 0.0 * upright)
    torque = np.full((len(t), 1), 0.1)
    found = behind_elasticity(swing, motion, torque, np.ones(1), NONE)
    assert np.isfinite(found).all()
    assert np.abs(found).max() < 1e4


def _stiffness(body: RigidBody, q: float) -> float:
    """Gravity's stiffness at a position [N m/rad]."""
    still = np.zeros((1, 1))
    return float(body.sensitivities(np.full((1, 1), q), still, still)[0][0, 0, 0])
