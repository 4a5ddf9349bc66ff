"""Changes of a prediction, against predictions of the changed arms."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis import synthetic

from gapscope.arm.motions.motion import Motion
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition
from gapscope.model.prediction import Prediction, without

EFFECTS = {
    "viscous_friction": ((1, 3), {"coefficient": [2.0, 1.0]}),
    "coulomb_friction": ((2,), {"torque": [1.5]}),
    "actuator_delay": ((1, 2), {"delay": [0.004, 0.01]}),
    "actuator_lag": ((3,), {"time_constant": [0.02]}),
    "torque_scale": ((2,), {"scale": [0.1]}),
    "torque_ripple": ((1,), {"amplitude": [0.5], "cycles": [12.0], "phase": [0.3]}),
    "encoder_offset": ((2,), {"offset": [0.02]}),
}


def effect(name: str) -> AppliedEffect:
    joints, values = EFFECTS[name]
    arrays = {key: np.array(value) for key, value in values.items()}
    return AppliedEffect(name, joints, arrays)


@pytest.fixture(scope="module")
def motion() -> Motion:
    recording = synthetic.recordings(synthetic.Truth(), duration=4.0)[1]
    return condition(recording, 20.0)[0].motion


ARM = CorrectedArm(synthetic.arm(), tuple(effect(name) for name in EFFECTS))


def test_arms_at_once_change_as_each_alone(motion: Motion) -> None:
    """Arms of which some undo another way from the recorded torque to the joint."""
    body = synthetic.body()
    at = Prediction.of(ARM, body, motion)
    names = [name for name in EFFECTS if name != "encoder_offset"]
    arms = [without(ARM, next(e for e in ARM.effects if e.name == n)) for n in names]
    changes = at.changes(arms)
    for change, arm in zip(np.moveaxis(changes, 1, 0), arms, strict=True):
        expected = arm.predict(body, motion) - ARM.predict(body, motion)
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(change, expected, atol=1e-9)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_share_of_an_effect_is_what_is_lost_without_it(
    motion: Motion, name: str
) -> None:
    body = synthetic.body()
    applied = next(e for e in ARM.effects if e.name == name)
    share = Prediction.of(ARM, body, motion).share_of(applied)
    expected = ARM.predict(body, motion) - without(ARM, applied).predict(body, motion)
    np.testing.assert_allclose(share, expected, atol=1e-9)
