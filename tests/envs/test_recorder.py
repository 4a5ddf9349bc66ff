"""The recorder: timing, controller, and what its columns hold."""

from dataclasses import replace

import numpy as np
import pytest
from cases import swinging
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record

DURATION = 5.0
RATE = 250.0


def _reference(arm: NominalArm) -> Fourier:
    rng = np.random.default_rng(0)
    return swinging(arm, rng, POSTURE, duration=DURATION, frequency=0.2)


def _record(arm: NominalArm, *effects: AppliedEffect, **options: object) -> Recording:
    settings = {"rng": np.random.default_rng(3), "duration": DURATION, "rate": RATE}
    law = position_controller(arm, POSTURE)
    return record(arm, effects, _reference(arm), law, **settings | options)


def _smooth(series: np.ndarray, cutoff: float) -> np.ndarray:
    return sosfiltfilt(butter(4, cutoff, output="sos", fs=RATE), series, axis=0)


@pytest.mark.parametrize("encoder", ["motor", "joint"])
def test_corrected_arm_follows_an_elastic_joint(
    data_sheet_arm: NominalArm, encoder: str
) -> None:
    """A soft joint that carries gravity: the corrected arm leaves less than a third of the gap, from either encoder."""
    # sticking has no law
    arm = replace(data_sheet_arm, encoder=encoder, coulomb=np.zeros(7))
    values = {"stiffness": [800.0], "damping": [30.0]}
    soft = AppliedEffect("joint_elasticity", (2,), values)
    recording = _record(arm, soft, encoder_step=0.0)
    spline = make_interp_spline(recording.t, _smooth(recording.q, 40.0), k=5)
    motion = Motion(recording.t, *(spline(recording.t, order) for order in range(3)))
    body = RigidBody(arm)
    predicted = (CorrectedArm(arm, x).predict(body, motion) for x in ((), (soft,)))
    gaps = (_smooth(recording.tau - tau, 12.0)[75:-75, 1] for tau in predicted)
    gap, left = (np.sqrt(np.mean(series**2)) for series in gaps)
    assert left < 0.3 * gap, (gap, left)


def test_columns_and_torque_by_the_documented_law(data_sheet_arm: NominalArm) -> None:
    """tau = g(q_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped, row by row."""
    arm = replace(data_sheet_arm, torque_limit=np.full(7, 35.0))
    law, reference = position_controller(arm, POSTURE), _reference(arm)
    law, rng = replace(law, feedforward="gravity"), np.random.default_rng(0)
    made = record(arm, (), reference, law, duration=2.0, rng=rng)
    assert (made.t[0], len(made.t)) == (0.0, 501)
    assert made.rate == pytest.approx(RATE)
    steps = made.q / arm.encoder_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    np.testing.assert_allclose(made.q_ref, reference.position(made.t))
    np.testing.assert_allclose(made.dq_ref, reference.velocity(made.t))

    zero = np.zeros_like(made.q)
    torque = RigidBody(arm).inverse_dynamics(made.q_ref, zero, zero)
    torque += law.kp * (made.q_ref - made.q) + law.kd * (made.dq_ref - made.dq)
    np.testing.assert_allclose(made.tau, np.clip(torque, -35.0, 35.0), atol=1e-9)
    assert np.abs(made.tau).max() == 35.0


def test_rate_must_divide_the_controllers(data_sheet_arm: NominalArm) -> None:
    with pytest.raises(InputError, match="divide"):
        _record(data_sheet_arm, rate=300.0)
