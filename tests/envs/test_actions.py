"""Actions that scale, models as feedforward, and other arms to simulate."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.actions import scaled
from gapscope.envs.environment import ArmTracking


def errors(arm: NominalArm, count: int = 7, **options: object) -> np.ndarray:
    """Errors over twenty steps with actions of zero."""
    env = ArmTracking(arm, **options)
    assert env.action_space.shape == (count,)
    rows = [env.reset(seed=2)[0]]
    rows += [env.step(np.zeros(count))[0] for _ in range(20)]
    env.close()
    return np.array(rows)[:, env.layout.slices["error"]]


@pytest.mark.parametrize(("action", "count"), [("scale", 14), ("gains", 1)])
def test_zero_actions_that_scale_are_the_controller_itself(
    data_sheet_arm: NominalArm, action: str, count: int
) -> None:
    scaling = errors(data_sheet_arm, count, action=action)
    np.testing.assert_array_equal(scaling, errors(data_sheet_arm))


def test_one_action_changes_all_gains(data_sheet_arm: NominalArm) -> None:
    gains = ArmTracking(data_sheet_arm).setup.control.gains
    factor, stiffer = scaled(gains, np.ones(1))
    assert factor == 1.0
    np.testing.assert_allclose(stiffer.kp, 2 * gains.kp)
    np.testing.assert_allclose(stiffer.kd, np.sqrt(2) * gains.kd)


def test_a_model_is_fed_forward_as_its_name_is(data_sheet_arm: NominalArm) -> None:
    arm, body = data_sheet_arm, RigidBody(data_sheet_arm)
    model = SimpleNamespace(
        series=lambda x: feedforward(arm, body, "nominal", x.q, x.dq, x.ddq)
    )
    named, given = (errors(arm, feedforward=way) for way in ("nominal", model))
    np.testing.assert_allclose(named, given, atol=1e-6)


def test_reach_gives_every_joint_the_same_say(data_sheet_arm: NominalArm) -> None:
    env = ArmTracking(data_sheet_arm, action_reach=0.02, bandwidth=4.0)
    np.testing.assert_allclose(env.torque_scale, 0.02 * env.setup.control.gains.kp)
    env.close()


def test_simulated_arms_are_checked(pendulum, data_sheet_arm: NominalArm) -> None:
    with pytest.raises(InputError, match="has the joints"):
        ArmTracking(pendulum(), simulated=CorrectedArm(data_sheet_arm))
    friction = AppliedEffect("viscous_friction", (1,), {"coefficient": [1.0]})
    with pytest.raises(InputError, match="leave them out"):
        ArmTracking(pendulum(), simulated=CorrectedArm(pendulum()), effects=(friction,))
    predicts = CorrectedArm(pendulum(), remainder=np.full((1, 10), 0.01))
    with pytest.warns(ModelWarning, match="remainder of the bodies is left out"):
        ArmTracking(pendulum(), simulated=predicts).close()
