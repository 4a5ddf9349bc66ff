"""Actions that scale, models as feedforward, and other arms to simulate."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.actions import scaled
from gapscope.envs.environment import ArmTracking


class Believed:
    """A model: the nominal inverse dynamics."""

    def __init__(self, arm: NominalArm) -> None:
        self.arm, self.body = arm, RigidBody(arm)

    def series(self, motion: Motion) -> np.ndarray:
        return feedforward(
            self.arm, self.body, "nominal", motion.q, motion.dq, motion.ddq
        )


def run(env: ArmTracking, action: np.ndarray, steps: int = 20) -> list[np.ndarray]:
    out = [env.reset(seed=2)[0]]
    out += [env.step(action)[0] for _ in range(steps)]
    env.close()
    return out


def test_scale_with_zero_actions_is_the_controller_itself(
    data_sheet_arm: NominalArm,
) -> None:
    plain = ArmTracking(data_sheet_arm)
    scaling = ArmTracking(data_sheet_arm, action="scale")
    assert scaling.action_space.shape == (14,) and scaling.layout.slices[
        "action"
    ] == slice(21, 35)
    part = scaling.layout.slices["error"]
    for one, other in zip(
        run(plain, np.zeros(7)), run(scaling, np.zeros(14)), strict=True
    ):
        np.testing.assert_array_equal(one[plain.layout.slices["error"]], other[part])


def test_one_action_changes_all_gains(data_sheet_arm: NominalArm) -> None:
    env = ArmTracking(data_sheet_arm, action="gains")
    assert env.action_space.shape == (1,)
    gains = env.setup.control.gains
    factor, stiffer = scaled(gains, np.ones(1))
    assert factor == 1.0
    np.testing.assert_allclose(stiffer.kp, 2 * gains.kp)
    np.testing.assert_allclose(stiffer.kd, np.sqrt(2) * gains.kd)
    zero = run(env, np.zeros(1))[-1][env.layout.slices["error"]]
    plain = ArmTracking(data_sheet_arm)
    np.testing.assert_array_equal(
        zero, run(plain, np.zeros(7))[-1][plain.layout.slices["error"]]
    )


def test_a_model_is_fed_forward_as_its_name_is(data_sheet_arm: NominalArm) -> None:
    named = run(ArmTracking(data_sheet_arm, feedforward="nominal"), np.zeros(7))
    given = run(
        ArmTracking(data_sheet_arm, feedforward=Believed(data_sheet_arm)), np.zeros(7)
    )
    for one, other in zip(named, given, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_the_loop_does_not_take_the_filters_lag_for_an_error(
    data_sheet_arm: NominalArm,
) -> None:
    env, worst = (
        ArmTracking(
            data_sheet_arm, motion="fourier", bandwidth=4.0, episode_length=2.0
        ),
        0.0,
    )
    env.reset(seed=1)
    for _ in range(100):
        worst = max(worst, env.step(np.zeros(7))[4]["tracking_rms"])
    env.close()
    assert worst < 3e-4


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
