"""Models: what they feed forward is what the corrected arm predicts, for one sample and for a series."""

import numpy as np
from cases import limits, motion_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from gapscope.agents.models import ArmModel
from gapscope.agents.tracking import Feedforward, Tuning
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw

IN_TIME = {"actuator_lag", "actuator_delay", "joint_elasticity", "backlash"}
INSTANT = sorted(set(CATALOGUE) - IN_TIME - {"friction_drift", "external_force"})
"""Effects that a single sample undoes."""
REFERENCE = Fourier.random(
    *(np.random.default_rng(1), limits(2, 2.0, 2.0, 8.0)),
    **{"duration": 2.0, "frequency": 0.4, "ramp": 0.5},
)


def samples(model: ArmModel, t: np.ndarray) -> np.ndarray:
    """The model's single samples, each joint looked at ahead of time."""
    out = np.empty((len(t), 2))
    for joint, ahead in enumerate(model.ahead):
        seen = motion_of(REFERENCE, t + ahead)
        states = zip(seen.q, seen.dq, seen.ddq, strict=True)
        out[:, joint] = [model(*now)[joint] for now in states]
    return out


@settings(
    max_examples=40,
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


def both(
    arm: NominalArm, effect: AppliedEffect, t: np.ndarray
) -> tuple[ArmModel, np.ndarray, np.ndarray]:
    """The model with an effect, what it plans, and what the arm needs without it."""
    model, motion = ArmModel(CorrectedArm(arm, (effect,))), motion_of(REFERENCE, t)
    return model, model.series(motion), ArmModel(CorrectedArm(arm)).series(motion)


def test_a_delay_is_made_up_for_by_looking_ahead(two: NominalArm) -> None:
    delay = AppliedEffect("actuator_delay", (2,), {"delay": [0.013]})
    t, inner = np.arange(0.0, 2.2, 1e-3), slice(100, 1900)
    model, planned, needed = both(two, delay, t)
    np.testing.assert_array_equal(model.ahead, [0.0, 0.013])
    early, due = planned[:-13, 1][inner], needed[13:, 1][inner]
    np.testing.assert_allclose(early, due, atol=0.05)
    np.testing.assert_array_equal(planned[:, 0], needed[:, 0])
    some = inner, slice(None, None, 50)
    found = samples(model, t[inner][::50])
    np.testing.assert_allclose(found, planned[some[0]][some[1]], atol=0.05)


def test_a_lag_is_undone_so_that_the_needed_torque_arrives(two: NominalArm) -> None:
    smooth = NominalArm("smooth", two.urdf, two.joints, armature=two.armature)
    lag, share = AppliedEffect("actuator_lag", (1,), {"time_constant": [0.02]}), 0.05
    _, planned, needed = both(smooth, lag, np.arange(0.0, 2.0, 1e-3))
    commanded, due = planned[:, 0], needed[:, 0]
    # each step of 1 ms closes a twentieth
    arrives, _ = lfilter([0.0, share], [1.0, share - 1.0], commanded, zi=[(1 - share) * due[0]])  # fmt: skip
    arrives[0] = due[0]
    change = np.abs(commanded - due).max()
    assert change > 0.5
    np.testing.assert_allclose(arrives, due, atol=0.05 * change)
