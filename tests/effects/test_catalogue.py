"""A contract that every effect of the catalogue keeps, and the checks of an effect with values."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, COUPLED_MOTORS, effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import QUANTITIES, SHEET, Effect
from gapscope.effects.severity import draw, possible

every_effect = pytest.mark.parametrize("definition", CATALOGUE.values(), ids=CATALOGUE)


def with_values(definition: Effect, which: int) -> AppliedEffect:
    """An effect at the lower (0) or upper (1) end of what real arms have."""
    joints = (2,) if definition.scope == "joint" else ()
    values = {
        p.name: np.full(p.size, p.typical[which])
        if joints or p.size > 1
        else p.typical[which]
        for p in definition.parameters
    }
    if definition.scope == "link":
        values["link"] = 2
    return AppliedEffect(definition.name, joints, values)


@every_effect
def test_definition(definition: Effect) -> None:
    """What ``check_effect`` does not ask of a user's effect; see ``test_own_effects``."""
    assert CATALOGUE[definition.name] is definition is effect(definition.name)
    assert definition.equation and definition.looks_like and definition.reference
    for other, recording in definition.confused_with:
        assert other in CATALOGUE and other != definition.name and recording
    assert all(parameter.symbol for parameter in definition.parameters)
    with pytest.raises(KeyError, match="has no parameter 'nonsense'"):
        definition.parameter("nonsense")


UNSEEN = {"encoder_quantization", "external_force", "torque_saturation", "backlash"}
"""What a prediction from motion need not show: rounding, a push at another time, a limit out of reach, free play."""


@every_effect
@pytest.mark.parametrize("which", [0, 1], ids=["least", "most"])
def test_typical_values_predict_a_finite_torque_that_differs(
    two: NominalArm, body: RigidBody, motion: Motion, definition: Effect, which: int
) -> None:
    applied = with_values(definition, which)
    nominal = CorrectedArm(two).predict(body, motion)
    predicted = CorrectedArm(two, (applied,)).predict(body, motion)
    assert predicted.shape == nominal.shape and np.isfinite(predicted).all()
    if definition.name not in UNSEEN:
        assert np.abs(predicted - nominal).max() > 1e-4
    if definition.scope == "joint" and definition.family not in (
        "sensing",
        "transmission",
    ):
        assert np.abs(predicted - nominal)[:, 0].max() < 1e-9
    rest = Motion(motion.t, motion.q, np.zeros_like(motion.q), np.zeros_like(motion.q))
    assert np.isfinite(CorrectedArm(two, (applied,)).predict(body, rest)).all()


COULOMB, NO = "coulomb_friction", [0, 0, 0]
BAD = [
    ("stiction", (1,), {"torque": [1.0]}, "unknown effect 'stiction'"),
    ("payload", (), {"mass": 1.0}, "payload: expected the parameters mass, com"),
    (COULOMB, (1,), {"torque": [1.0], "b": [1.0]}, "expected the parameters torque"),
    (COULOMB, (1,), {"torque": [1.0, 2.0]}, "expected 1 values, got 2"),
    ("payload", (), {"mass": 1.0, "com": 0.1}, r"payload\.com: expected 3 values"),
    ("payload", (), {"mass": [1.0], "com": NO}, r"payload\.mass: expected 1 values"),
    ("torque_scale", (1,), {"scale": [99.0]}, r"scale: value \[99.0\] outside "),
    (COULOMB, (1,), {"torque": [np.nan]}, r"value \[nan\] outside"),
    ("link_inertia", (), {"link": 2.5, "mass": 1.0, "com": NO}, "link is a whole"),
    (COULOMB, (1.5,), {"torque": [1.0]}, "joints count from 1"),
    (COULOMB, (0,), {"torque": [1.0]}, r"from 1 and occur once, got \[0\]"),
    (COULOMB, (2, 2), {"torque": [1.0, 1.0]}, r"occur once, got \[2, 2\]"),
    (COULOMB, (), {"torque": [1.0]}, r"scope joint, but joints are \[\]"),
    ("payload", (1,), {"mass": 1.0, "com": NO}, r"scope arm, but joints are \[1\]"),
]


@pytest.mark.parametrize(("name", "joints", "values", "message"), BAD)
def test_values_that_cannot_be(
    name: str, joints: tuple[int, ...], values: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        AppliedEffect(name, joints, values)


def test_joint_too_large() -> None:
    applied = AppliedEffect("coulomb_friction", (2, 7), {"torque": [1.0, 2.0]})
    np.testing.assert_array_equal(applied.per_joint("torque", 7), [0, 1, 0, 0, 0, 0, 2])
    with pytest.raises(
        InputError, match="coulomb_friction: joint 7 of an arm with 6 joints"
    ):
        applied.per_joint("torque", 6)


def test_one_number_counts_for_every_joint() -> None:
    applied = AppliedEffect("actuator_delay", (1, 3), {"delay": 0.01})
    np.testing.assert_array_equal(applied.parameters["delay"], [0.01, 0.01])


def test_values_are_copied_and_read_only() -> None:
    given = np.array([1.0])
    applied = AppliedEffect("coulomb_friction", (1,), {"torque": given})
    given[0] = 5.0
    assert applied.parameters["torque"][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        applied.parameters["torque"][0] = 5.0


@pytest.mark.parametrize(
    "definition",
    [
        each
        for each in (*CATALOGUE.values(), *COUPLED_MOTORS.values())
        if each.scope == "joint" and each.quantities
    ],
    ids=lambda definition: definition.name,
)
def test_quantities_of_drives_are_those_of_the_data_sheet_and_of_one_effect(
    two: NominalArm, definition: Effect
) -> None:
    assert set(definition.quantities) == set(definition.names)
    values = {
        own: np.array([definition.parameter(name).typical[1]])
        for name, own in definition.quantities.items()
    }
    applied = drives_with((2,), **values)
    assert applied.effect is definition
    for name, value in values.items():
        without, with_it = (
            CorrectedArm(two, effects).quantity(name) for effects in ((), (applied,))
        )
        stated = SHEET.get(name)
        nominal = 0.0 if stated is None else getattr(two, stated)
        assert name in QUANTITIES and (without == nominal).all()
        assert with_it[1] == without[1] + value[0]
        assert (np.delete(with_it, 1) == np.delete(without, 1)).all()


# Severities drawn at random.


@pytest.fixture(scope="module", params=["kuka_iiwa", "franka_panda", "xarm6"])
def arm(request: pytest.FixtureRequest):
    return load_nominal_arm(request.param)


def test_every_effect_is_drawn_within_its_bounds_and_from_the_seed_alone(arm) -> None:
    scale = ArmScale.of(arm)
    for name in CATALOGUE:
        first, second = (
            [draw(name, np.random.default_rng(seed), scale) for seed in range(20)]
            for _ in range(2)
        )
        for one, other in zip(first, second, strict=True):
            assert one.joints == other.joints and len(one.joints) <= 2
            for key in one.parameters:
                np.testing.assert_array_equal(
                    one.parameters[key], other.parameters[key]
                )
        key = "mass" if "mass" in first[0].parameters else CATALOGUE[name].names[0]
        assert (
            len({np.atleast_1d(one.parameters[key]).tolist()[0] for one in first}) > 3
        )


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("stribeck_friction", "velocity"), ("encoder_quantization", "step")],
)
def test_what_does_not_depend_on_the_arm_covers_what_is_met_on_real_arms(
    arm, name: str, parameter: str
) -> None:
    """The whole of the catalogue's typical range, and nothing beyond it."""
    scale, rng = ArmScale.of(arm), np.random.default_rng(0)
    drawn = np.concatenate(
        [draw(name, rng, scale).parameters[parameter] for _ in range(300)]
    )
    low, high = CATALOGUE[name].parameter(parameter).typical
    assert low <= 1.01 * drawn.min() and drawn.max() <= 1.01 * high
    assert drawn.min() < 1.1 * low and drawn.max() > 0.9 * high


def test_joints_may_be_chosen(arm) -> None:
    assert draw(
        "backlash", np.random.default_rng(0), ArmScale.of(arm), joints=(5, 2)
    ).joints == (2, 5)


def test_a_motor_of_its_own_needs_rotors(arm) -> None:
    assert set(CATALOGUE) - set(possible(arm)) == {"joint_elasticity", "backlash"}
