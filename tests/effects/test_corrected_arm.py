"""The corrected arm: how effects compose, whatever their order in the file."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import iiwa_of_three

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import behind_elasticity
from gapscope.effects.free_play import behind_play

COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [3.0]})
VISCOUS = AppliedEffect("viscous_friction", (2,), {"coefficient": [2.0]})
LOAD = AppliedEffect("load_friction", (2,), {"coefficient": [0.2]})
ARMATURE = AppliedEffect("armature", (2,), {"inertia": [0.5]})
OFFSET = AppliedEffect("torque_offset", (2,), {"torque": [2.0]})
SCALE = AppliedEffect("torque_scale", (2,), {"scale": [0.25]})
DELAY = AppliedEffect("actuator_delay", (2,), {"delay": [0.02]})
ENCODER = AppliedEffect("encoder_offset", (1, 2), {"offset": [0.1, -0.3]})
PAYLOAD = AppliedEffect("payload", (), {"mass": 1.2, "com": [0.3, 0.1, 0.0]})


ELASTIC = AppliedEffect(
    "joint_elasticity", (2,), {"stiffness": [2000.0], "damping": [5.0]}
)
PLAY = AppliedEffect("backlash", (2,), {"width": [0.01]})


def steady(dq: float, ddq: float = 0.0) -> Motion:
    t = np.arange(11) / 10
    zero = np.zeros((11, 2))
    return Motion(
        t,
        zero,
        np.column_stack([zero[:, 0], np.full(11, dq)]),
        np.column_stack([zero[:, 0], np.full(11, ddq)]),
    )


def test_nominal_arm_is_rigid_body_and_data_sheet(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """Against pinocchio, with armature 0.3 and 0.1, Coulomb 1 and 0.5, viscous 0.8 and 0.4 added by hand."""
    model = pin.buildModelFromUrdf(str(two.urdf))
    data = model.createData()
    rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
    expected = np.array([pin.rnea(model, data, *row) for row in rows])
    expected += (
        [0.3, 0.1] * motion.ddq
        + [1.0, 0.5] * np.tanh(motion.dq / 0.005)
        + [0.8, 0.4] * motion.dq
    )
    np.testing.assert_allclose(
        CorrectedArm(two).predict(body, motion), expected, atol=1e-9
    )


@pytest.mark.parametrize("order", list(itertools.permutations((OFFSET, SCALE))))
def test_offset_lies_nearest_to_the_joint(
    two: NominalArm, order: tuple[AppliedEffect, ...]
) -> None:
    """applied = 1.25 recorded + 2: for 10 N m at the joint 6.4 are recorded, not 10 / 1.25 - 2 = 6."""
    needed = np.full((11, 2), 10.0)
    recorded = CorrectedArm(two, order).recorded_torque(needed, steady(0.0))
    np.testing.assert_allclose(recorded[:, 1], 6.4)
    np.testing.assert_allclose(recorded[:, 0], 10.0)


@pytest.mark.parametrize("order", list(itertools.permutations((DELAY, OFFSET, SCALE))))
def test_the_whole_way_to_the_joint(
    two: NominalArm, order: tuple[AppliedEffect, ...], motion: Motion
) -> None:
    """recorded(t) = (needed(t + T) - offset) / (1 + s)."""
    needed = np.column_stack([np.cos(2 * motion.t), np.sin(5 * motion.t)])
    recorded = CorrectedArm(two, order).recorded_torque(needed, motion)
    inner = slice(0, 490)
    np.testing.assert_allclose(
        recorded[inner, 1],
        (np.sin(5 * (motion.t + 0.02))[inner] - 2.0) / 1.25,
        atol=1e-6,
    )
    np.testing.assert_array_equal(recorded[:, 0], needed[:, 0])


@pytest.mark.parametrize(
    "order", list(itertools.permutations((COULOMB, VISCOUS, ARMATURE, LOAD)))[::5]
)
def test_load_friction_acts_on_the_whole_motor_torque(
    two: NominalArm, order: tuple[AppliedEffect, ...]
) -> None:
    """rigid 10 + Coulomb 0.5 + 3, viscous (0.4 + 2) v with v = 1, rotor (0.1 + 0.5) 2: 17.1, over 1 - 0.2."""
    needed = CorrectedArm(two, order).needed_torque(
        np.full((11, 2), 10.0), steady(1.0, 2.0)
    )
    np.testing.assert_allclose(needed[:, 1], 17.1 / 0.8)
    back = CorrectedArm(two, order).needed_torque(
        np.full((11, 2), 10.0), steady(-1.0, 2.0)
    )
    np.testing.assert_allclose(back[:, 1], (10 + 1.2 - 3.5 - 2.4) / 1.2)


@pytest.mark.parametrize("order", [(ENCODER, PAYLOAD), (PAYLOAD, ENCODER)])
def test_payload_hangs_where_the_arm_truly_is(
    two: NominalArm, body: RigidBody, motion: Motion, order: tuple[AppliedEffect, ...]
) -> None:
    model = pin.buildModelFromUrdf(str(two.urdf))
    model.appendBodyToJoint(
        2,
        pin.Inertia(1.2, np.array([0.3, 0.1, 0.0]), np.zeros((3, 3))),
        pin.SE3.Identity(),
    )
    data = model.createData()
    true = motion.q - [0.1, -0.3]
    expected = np.array(
        [
            pin.rnea(model, data, *row)
            for row in zip(true, motion.dq, motion.ddq, strict=True)
        ]
    )
    np.testing.assert_allclose(
        CorrectedArm(two, order).rigid_torque(body, motion), expected, atol=1e-9
    )


def test_all_effects_in_any_order_predict_the_same(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    effects = (COULOMB, VISCOUS, LOAD, ARMATURE, OFFSET, SCALE, DELAY, ENCODER, PAYLOAD)
    expected = CorrectedArm(two, effects).predict(body, motion)
    rng = np.random.default_rng(0)
    for _ in range(5):
        shuffled = tuple(effects[i] for i in rng.permutation(len(effects)))
        np.testing.assert_allclose(
            CorrectedArm(two, shuffled).predict(body, motion), expected, atol=1e-9
        )


@pytest.mark.parametrize(
    "effects", [(ELASTIC,), (PLAY,), (ELASTIC, PLAY)], ids=["elastic", "play", "both"]
)
def test_links_behind_the_motors_carry_the_payload(
    two: NominalArm, body: RigidBody, motion: Motion, effects: tuple[AppliedEffect, ...]
) -> None:
    """Of a joint with both the spring is felt beyond the free play; the bodies are those with the load."""
    spring, damper = ELASTIC.per_joint("stiffness", 2), ELASTIC.per_joint("damping", 2)
    none, width = np.zeros(2), PLAY.per_joint("width", 2)
    loaded = CorrectedArm(two, (PAYLOAD,)).body(body)
    torque = loaded.inverse_dynamics(motion.q, motion.dq, motion.ddq)
    if PLAY not in effects:
        expected = behind_elasticity(loaded, motion, torque, spring, damper)
    else:
        stiff = (spring, damper) if ELASTIC in effects else (none, none)
        expected = behind_play(loaded, motion, torque, width, *stiff)
    for order in itertools.permutations((*effects, PAYLOAD)):
        np.testing.assert_allclose(
            CorrectedArm(two, order).rigid_torque(body, motion), expected, atol=1e-8
        )
    assert np.abs(expected - torque).max() > 1e-3 * np.abs(torque).max()


def test_encoders_on_the_joints_see_the_links_themselves(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """The bodies' torque is rigid; only the motor, with its rotor and friction, moves otherwise."""
    outside = replace(two, encoder="joint")
    rigid = body.inverse_dynamics(motion.q, motion.dq, motion.ddq)
    for effects in ((ELASTIC,), (PLAY,), (ELASTIC, PLAY)):
        np.testing.assert_allclose(
            CorrectedArm(outside, effects).rigid_torque(body, motion), rigid, atol=1e-9
        )
    plain, bent = (
        CorrectedArm(outside, e).needed_torque(rigid, motion) for e in ((), (ELASTIC,))
    )
    np.testing.assert_allclose(bent[:, 0], plain[:, 0])
    assert np.abs(bent - plain)[:, 1].max() > 1e-3


def test_value_over_all_joints(two: NominalArm) -> None:
    np.testing.assert_array_equal(
        CorrectedArm(two, (COULOMB,)).value("coulomb_friction", "torque"), [0.0, 3.0]
    )
    np.testing.assert_array_equal(
        CorrectedArm(two).value("coulomb_friction", "torque"), [0.0, 0.0]
    )


def test_joint_that_the_arm_does_not_have(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    effect = AppliedEffect("coulomb_friction", (3,), {"torque": [1.0]})
    with pytest.raises(InputError, match="joint 3 of an arm with 2 joints"):
        CorrectedArm(two, (effect,)).predict(body, motion)


@pytest.mark.parametrize(
    "once",
    [
        AppliedEffect("torque_saturation", (2,), {"limit": [10.0]}),
        AppliedEffect("base_tilt", (), {"roll": 0.01, "pitch": 0.0}),
    ],
)
def test_an_effect_that_cannot_add_occurs_once(
    two: NominalArm, once: AppliedEffect
) -> None:
    """Two limits on one joint are no limit of their sum, two tilts no tilt of either."""
    with pytest.raises(InputError, match="occurs twice") as caught:
        CorrectedArm(two, (COULOMB, once, once)).check()
    assert caught.value.where == once.name


def test_effects_that_add_may_occur_twice(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    half = AppliedEffect("payload", (), {"mass": 0.6, "com": [0.3, 0.1, 0.0]})
    arms = [CorrectedArm(two, effects) for effects in ((half, half), (PAYLOAD,))]
    for arm in arms:
        arm.check()
    np.testing.assert_allclose(*(arm.predict(body, motion) for arm in arms), rtol=1e-9)


def test_what_bodies_lack_adds_its_own_torque_and_need_not_be_possible() -> None:
    """Minus two kilograms on the second link: as the regressor has it, whatever the arm carries."""
    t = np.arange(50) / 50
    q = np.column_stack([np.sin((k + 1) * t) for k in range(3)])
    motion = Motion(t, q, np.gradient(q, t, axis=0), np.cos(q))
    arm, remainder = iiwa_of_three(), np.zeros((3, 10))
    remainder[1, :2] = -2.0, 0.3
    body = RigidBody(arm)
    plain = CorrectedArm(arm, (PAYLOAD,))
    lacking = replace(plain, remainder=remainder)
    lacking.check()
    added = lacking.predict(body, motion) - plain.predict(body, motion)
    own = body.regressor(motion.q, motion.dq, motion.ddq) @ remainder.ravel()
    assert added == pytest.approx(own, abs=1e-9)
