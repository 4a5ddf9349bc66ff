"""Models: what they feed forward is what the corrected arm predicts, for one sample and for a series."""

import numpy as np
from cases import limits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from gapscope.agents.models import ArmModel
from gapscope.agents.tracking import Feedforward, Tuning
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, motion_of
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw

LASTING = ("actuator_lag", "actuator_delay", "joint_elasticity", "backlash")
LASTING += ("friction_drift", "external_force")
"""Effects that no single sample undoes."""
INSTANT = sorted(set(CATALOGUE) - set(LASTING))
HOW = {"duration": 2.0, "frequency": 0.4, "ramp": 0.5}
REFERENCE = Fourier.random(np.random.default_rng(1), limits(2, 2.0, 2.0, 8.0), **HOW)


def samples(model: ArmModel, t: np.ndarray) -> np.ndarray:
    """The model's single samples, each joint looked at ahead of time."""
    out = np.empty((len(t), 2))
    for joint, ahead in enumerate(model.ahead):
        seen = motion_of(REFERENCE, t + ahead)
        for k, now in enumerate(zip(seen.q, seen.dq, seen.ddq, strict=True)):
            out[k, joint] = model(*now)[joint]
    return out


@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(names=st.sets(st.sampled_from(INSTANT), max_size=4), seed=st.integers(0, 2**20))
def test_feedforward_is_what_the_corrected_arm_predicts(
    two: NominalArm, names: set[str], seed: int
) -> None:
    rng, scale = np.random.default_rng(seed), ArmScale.of(two)
    effects = tuple(draw(name, rng, scale) for name in sorted(names))
    corrected = CorrectedArm(two, effects)
    model, seen = ArmModel(corrected), motion_of(REFERENCE, np.linspace(0.0, 2.0, 101))
    predicted = corrected.predict(RigidBody(two), seen)
    fed = Feedforward(Tuning().gains(np.ones(2)), np.full(2, np.inf), model)
    np.testing.assert_array_equal(fed.plan(seen), predicted)
    near = 1e-9 * np.abs(predicted).max()
    np.testing.assert_allclose(samples(model, seen.t), predicted, atol=near)


def test_a_delay_is_made_up_for_by_looking_ahead(two: NominalArm) -> None:
    delay = AppliedEffect("actuator_delay", (2,), {"delay": [0.013]})
    model, plain = ArmModel(CorrectedArm(two, (delay,))), ArmModel(CorrectedArm(two))
    np.testing.assert_array_equal(model.ahead, [0.0, 0.013])
    t = np.arange(0.0, 2.2, 1e-3)
    planned, needed = (x.series(motion_of(REFERENCE, t)) for x in (model, plain))
    np.testing.assert_allclose(planned[100:1900, 1], needed[113:1913, 1], atol=0.05)
    np.testing.assert_array_equal(planned[:, 0], needed[:, 0])
    few = slice(100, 1900, 50)
    np.testing.assert_allclose(samples(model, t[few]), planned[few], atol=0.05)


def test_a_lag_is_undone_so_that_the_needed_torque_arrives(two: NominalArm) -> None:
    smooth = NominalArm("smooth", two.urdf, two.joints, armature=two.armature)
    lag = AppliedEffect("actuator_lag", (1,), {"time_constant": [0.02]})
    seen = motion_of(REFERENCE, np.arange(0.0, 2.0, 1e-3))
    commanded, needed = (
        ArmModel(CorrectedArm(smooth, effects)).series(seen)[:, 0]
        for effects in ((lag,), ())
    )
    arrives, _ = lfilter([0.05], [1, -0.95], commanded[:-1], zi=[0.95 * needed[0]])
    late = np.abs(commanded - needed).max()
    assert late > 0.5
    np.testing.assert_allclose(arrives, needed[1:], atol=0.05 * late)
