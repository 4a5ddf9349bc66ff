"""Domain randomisation: other effects in every episode, the same for the same seed, of realistic size."""

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.envs.environment import ArmTracking
from gapscope.envs.randomisation import Randomisation, RandomiseEffects, draw_effects


def _draw(arm: NominalArm, seed: int, **options: object) -> tuple[AppliedEffect, ...]:
    wanted = Randomisation(**({"names": sorted(CATALOGUE), "count": (1, 3)} | options))
    return draw_effects(np.random.default_rng(seed), arm, wanted, ArmScale.of(arm))


def _plain(effects: tuple[AppliedEffect, ...]) -> list[object]:
    return [
        (e.name, e.joints, {k: v.tolist() for k, v in e.parameters.items()})
        for e in effects
    ]


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_can_be_drawn_mild_and_severe(
    data_sheet_arm: NominalArm, name: str
) -> None:
    """Its severity multiplies or divides what says how severe it is, and leaves the rest."""
    options = {"names": [name], "count": (1, 1)}
    (half,), (whole,) = (
        _draw(data_sheet_arm, 1, severity=(s, s), **options) for s in (0.5, 1.0)
    )
    ratios = {}
    for name in whole.given:
        small, large = half.parameters[name], whole.parameters[name]
        kept = np.abs(large) > 0
        ratios[name] = float(
            np.median((small[kept] if small.ndim else small) / large[kept])
        )
    allowed = (0.5, 1.0, 2.0)
    assert all(
        min(abs(ratio - r) for r in allowed) < 1e-9 for ratio in ratios.values()
    ), ratios
    assert any(abs(ratio - 1) > 0.1 for ratio in ratios.values())


def test_draws_are_varied_on_the_joints_allowed_and_as_many_as_asked(
    data_sheet_arm: NominalArm,
) -> None:
    arm, scale = data_sheet_arm, ArmScale.of(data_sheet_arm)
    wanted = Randomisation(sorted(CATALOGUE), joints=[2, 4], count=(0, 2))
    rngs = map(np.random.default_rng, range(200))
    drawn = [draw_effects(rng, arm, wanted, scale) for rng in rngs]
    assert {len(effects) for effects in drawn} == {0, 1, 2}
    assert {effect.name for effects in drawn for effect in effects} == set(CATALOGUE)
    assert {
        joint for effects in drawn for effect in effects for joint in effect.joints
    } == {2, 4}
    assert all(
        len({effect.name for effect in effects}) == len(effects) for effects in drawn
    )


def test_an_elastic_joint_without_a_rotor_is_given_one(bare_arm: NominalArm) -> None:
    drawn = _draw(bare_arm, 0, names=["backlash"], count=(1, 1))
    assert [effect.name for effect in drawn] == ["backlash", "armature"] and drawn[
        0
    ].joints == drawn[1].joints


def test_what_is_given_is_not_drawn_again(data_sheet_arm: NominalArm) -> None:
    given = (AppliedEffect("payload", (), {"mass": 1.0, "com": [0, 0, 0]}),)
    wanted = Randomisation(["payload", "armature"], count=(2, 2))
    drawn = draw_effects(
        np.random.default_rng(0),
        data_sheet_arm,
        wanted,
        ArmScale.of(data_sheet_arm),
        given,
    )
    assert [effect.name for effect in drawn] == ["armature"]


def test_same_seed_same_effects_and_motions_as_option_and_as_wrapper() -> None:
    wanted = Randomisation(
        ["coulomb_friction", "payload", "actuator_delay"], severity=(0.2, 0.8)
    )
    envs = [
        ArmTracking(randomisation=wanted, episode_length=0.2),
        RandomiseEffects(ArmTracking(episode_length=0.2), wanted),
        ArmTracking(episode_length=0.2),
    ]
    episodes = []
    for env in envs:
        rows, effects = [], []
        for seed in (7, None, None):
            rows.append(env.reset(seed=seed)[0])
            effects.append(_plain(env.unwrapped.effects))
            rows += [env.step(np.zeros(7, np.float32))[0] for _ in range(10)]
        episodes.append((np.array(rows), effects))
        env.close()
    (option, drawn), (wrapped, again), (plain, none) = episodes
    np.testing.assert_array_equal(option, wrapped)
    assert drawn == again and drawn[0] != drawn[1] and none == [[], [], []]
    reference = envs[0].unwrapped.layout.slices["reference"]
    np.testing.assert_array_equal(option[:, reference], plain[:, reference])
    assert not np.array_equal(option, plain)


BAD = [
    ({"names": ["coulomb"]}, "did you mean 'coulomb_friction'"),
    ({"names": []}, "names: expected a list"),
    ({"names": ["payload"], "joints": [0]}, "joints: expected a whole number"),
    ({"names": ["payload"], "severity": (0.0, 1.5)}, "severity"),
    ({"names": ["payload"], "count": (1, 2)}, "count"),
    ({"names": ["payload"], "joint_count": (0, 1)}, "joint_count"),
    ({"names": 3}, "randomisation.names: expected a list"),
    ({"names": ["payload"], "joints": 2}, "randomisation.joints: expected a list"),
    ({"names": ["payload"], "count": 1}, "randomisation.count: expected a list"),
    ({"names": ["payload"], "count": (0.5, 1)}, "whole number"),
    ({"names": ["payload"], "severity": (0.5, float("nan"))}, "severity"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=lambda value: str(value)[:40])
def test_bad_requests_are_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Randomisation(**options)
