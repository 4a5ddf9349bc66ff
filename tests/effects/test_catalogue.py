"""A contract that every effect of the catalogue keeps, and the checks of an effect with values."""

from __future__ import annotations

from dataclasses import replace

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
        p.name: np.full(p.size, p.typical[which]) if p.size > 1 else p.typical[which]
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
SEEN_BY_OTHERS = ("sensing", "transmission")
"""Families that change where the links are, and so the torque of other joints."""


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
    if definition.scope == "joint" and definition.family not in SEEN_BY_OTHERS:
        assert np.abs(predicted - nominal)[:, 0].max() < 1e-9
    rest = Motion(motion.t, motion.q, 0 * motion.q, 0 * motion.q)
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
    message = "coulomb_friction: joint 7 of an arm with 6 joints"
    with pytest.raises(InputError, match=message):
        applied.per_joint("torque", 6)


def test_values_are_copied_for_every_joint_and_read_only() -> None:
    given = np.array([1.0, 2.0])
    applied = AppliedEffect("coulomb_friction", (1, 2), {"torque": given})
    given[0] = 5.0
    assert applied.parameters["torque"][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        applied.parameters["torque"][0] = 5.0
    delay = AppliedEffect("actuator_delay", (1, 3), {"delay": 0.01})
    np.testing.assert_array_equal(delay.parameters["delay"], [0.01, 0.01])


EVERY = (*CATALOGUE.values(), *COUPLED_MOTORS.values())
OF_DRIVES = [each for each in EVERY if each.scope == "joint" and each.quantities]


@pytest.mark.parametrize("definition", OF_DRIVES, ids=lambda each: each.name)
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
    plain, changed = CorrectedArm(two), CorrectedArm(two, (applied,))
    for name, value in values.items():
        without, with_it = plain.quantity(name), changed.quantity(name)
        stated = SHEET.get(name)
        nominal = 0.0 if stated is None else getattr(two, stated)
        assert name in QUANTITIES and (without == nominal).all()
        assert with_it[1] == without[1] + value[0]
        assert (np.delete(with_it, 1) == np.delete(without, 1)).all()


# Severities drawn at random.


@pytest.fixture(scope="module", params=["kuka_iiwa", "xarm6"])
def scale(request: pytest.FixtureRequest) -> ArmScale:
    return ArmScale.of(load_nominal_arm(request.param))


def test_every_effect_is_drawn_from_the_seed_alone(scale: ArmScale) -> None:
    for name, definition in CATALOGUE.items():
        seen = set()
        for seed in range(8):
            one, other = (draw(name, np.random.default_rng(seed), scale) for _ in "ab")
            assert one.joints == other.joints and len(one.joints) <= 2
            for key, value in one.parameters.items():
                np.testing.assert_array_equal(value, other.parameters[key])
            key = "mass" if "mass" in one.parameters else definition.names[0]
            seen.add(float(np.ravel(one.parameters[key])[0]))
        assert len(seen) > 3


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("stribeck_friction", "velocity"), ("encoder_quantization", "step")],
)
def test_what_does_not_depend_on_the_arm_covers_what_is_met_on_real_arms(
    scale: ArmScale, name: str, parameter: str
) -> None:
    """The whole of the catalogue's typical range, and nothing beyond it."""
    rng = np.random.default_rng(0)
    drawn = [draw(name, rng, scale).parameters[parameter] for _ in range(200)]
    least, most = np.min(np.concatenate(drawn)), np.max(np.concatenate(drawn))
    low, high = CATALOGUE[name].parameter(parameter).typical
    assert 0.99 * low <= least < 1.1 * low and 0.9 * high < most <= 1.01 * high


def test_joints_may_be_chosen_and_a_motor_of_its_own_needs_rotors(
    scale: ArmScale, two: NominalArm
) -> None:
    drawn = draw("backlash", np.random.default_rng(0), scale, joints=(5, 2))
    assert drawn.joints == (2, 5)
    bare = replace(two, armature=np.zeros(2))
    assert set(CATALOGUE) - set(possible(bare)) == {"joint_elasticity", "backlash"}
