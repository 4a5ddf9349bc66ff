"""The recorder: timing, controller, and what its columns hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record

DURATION = 5.0
RATE = 250.0


def _reference(arm: NominalArm, seed: int = 0) -> Fourier:
    limits = urdf_limits(RigidBody(arm), acceleration=5.0)._replace(
        velocity=np.full(arm.n_joints, 1.2)
    )
    return Fourier.random(
        np.random.default_rng(seed),
        limits,
        duration=DURATION,
        centre=POSTURE,
        frequency=0.2,
    )


def _record(arm: NominalArm, *effects: AppliedEffect, **options: object) -> Recording:
    settings = {
        "rng": np.random.default_rng(3),
        "duration": DURATION,
        "rate": RATE,
    } | options
    return record(
        arm, effects, _reference(arm), position_controller(arm, POSTURE), **settings
    )


def _smooth(series: np.ndarray, rate: float = RATE) -> np.ndarray:
    return sosfiltfilt(butter(4, 12.0, output="sos", fs=rate), series, axis=0)


def _motion(recording: Recording) -> Motion:
    q = sosfiltfilt(butter(4, 40.0, output="sos", fs=RATE), recording.q, axis=0)
    spline = make_interp_spline(recording.t, q, k=5)
    return Motion(recording.t, *(spline(recording.t, order) for order in range(3)))


def _rms(series: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(series[75:-75] ** 2, axis=0))


@pytest.mark.parametrize("encoder", ["motor", "joint"])
def test_corrected_arm_follows_an_elastic_joint(
    data_sheet_arm: NominalArm, encoder: str
) -> None:
    """A soft joint that carries gravity: the corrected arm leaves less than a third of the gap, from either encoder."""
    arm = replace(
        data_sheet_arm, encoder=encoder, coulomb=np.zeros(7)
    )  # sticking has no law
    soft = AppliedEffect(
        "joint_elasticity", (2,), {"stiffness": [800.0], "damping": [30.0]}
    )
    recording = _record(arm, soft, encoder_step=0.0)
    motion, body = _motion(recording), RigidBody(arm)
    gap, left = (
        _rms(_smooth(recording.tau - CorrectedArm(arm, effects).predict(body, motion)))[
            1
        ]
        for effects in ((), (soft,))
    )
    assert left < 0.3 * gap, (gap, left)


@pytest.mark.parametrize("engine", ENGINES)
def test_torque_belongs_to_the_motion_of_its_own_row(
    engines, bare_arm: NominalArm, engine: str
) -> None:
    """Inverse dynamics of central differences against the torque: a skew of 0.005 dt, 0.05 dt on light joints."""
    dt = 1e-3
    recording = _record(bare_arm, rate=1000.0, encoder_step=0.0, engine=engines(engine))
    q = recording.q
    ddq, dq = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2, (q[2:] - q[:-2]) / (2 * dt)
    needed, torque = (
        RigidBody(bare_arm).inverse_dynamics(q[1:-1], dq, ddq),
        recording.tau,
    )
    rate = (torque[2:] - torque[:-2]) / (2 * dt)
    skew = ((needed - torque[1:-1]) * rate).sum(axis=0) / (rate**2).sum(axis=0)
    assert np.abs(skew).max() < 0.1 * dt, skew / dt
    np.testing.assert_allclose(needed, torque[1:-1], atol=0.01)


def test_columns(data_sheet_arm: NominalArm) -> None:
    recording = _record(data_sheet_arm)
    assert (
        recording.t[0] == 0.0
        and len(recording.t) == 1251
        and recording.rate == pytest.approx(RATE)
    )
    steps = recording.q / data_sheet_arm.encoder_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    reference = _reference(data_sheet_arm)
    np.testing.assert_allclose(recording.q_ref, reference.position(recording.t))
    np.testing.assert_allclose(recording.dq_ref, reference.velocity(recording.t))
    assert np.abs(recording.q - recording.q_ref).max() < 0.02
    assert np.abs(recording.dq - recording.dq_ref).max() < 0.2


def test_torque_is_the_documented_law_of_the_recorded_columns(
    data_sheet_arm: NominalArm,
) -> None:
    """tau = g(q_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped, row by row."""
    arm = replace(data_sheet_arm, torque_limit=np.full(7, 35.0))
    controller = replace(position_controller(arm, POSTURE), feedforward="gravity")
    recording = record(
        arm, (), _reference(arm), controller, duration=2.0, rng=np.random.default_rng(0)
    )
    zero = np.zeros_like(recording.q)
    torque = RigidBody(arm).inverse_dynamics(recording.q_ref, zero, zero)
    torque += controller.kp * (recording.q_ref - recording.q) + controller.kd * (
        recording.dq_ref - recording.dq
    )
    np.testing.assert_allclose(recording.tau, np.clip(torque, -35.0, 35.0), atol=1e-9)
    assert np.abs(recording.tau).max() == 35.0


def test_same_seed_same_recording_bit_by_bit(data_sheet_arm: NominalArm) -> None:
    effect = AppliedEffect("load_friction", (2, 4), {"coefficient": [0.15, 0.1]})
    first, second = (
        _record(data_sheet_arm, effect, torque_noise=0.1, duration=1.0)
        for _ in range(2)
    )
    for channel in ("q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(first, channel), getattr(second, channel))


def test_rate_must_divide_the_controllers(data_sheet_arm: NominalArm) -> None:
    with pytest.raises(InputError, match="divide"):
        _record(data_sheet_arm, rate=300.0)
