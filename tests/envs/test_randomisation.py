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


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_can_be_drawn_mild_and_severe(
    data_sheet_arm: NominalArm, name: str
) -> None:
    """Its severity multiplies or divides what says how severe it is, and leaves the rest."""
    options = {"names": [name], "count": (1, 1)}
    (half,), (whole,) = (
        _draw(data_sheet_arm, 1, severity=(s, s), **options) for s in (0.5, 1.0)
    )
    ratios = []
    for key in whole.given:
        small, large = (np.atleast_1d(x.parameters[key]) for x in (half, whole))
        acts = np.abs(large) > 0
        ratios.append(float(np.median(small[acts] / large[acts])))
    off = np.abs(np.subtract.outer(ratios, (0.5, 1.0, 2.0)))
    assert off.min(axis=1).max() < 1e-9, ratios
    # some value is another one
    assert off[:, 1].max() > 0.1


def test_draws_are_varied_on_the_joints_allowed_and_as_many_as_asked(
    data_sheet_arm: NominalArm,
) -> None:
    arm, scale = data_sheet_arm, ArmScale.of(data_sheet_arm)
    wanted = Randomisation(sorted(CATALOGUE), joints=[2, 4], count=(0, 2))
    rngs = map(np.random.default_rng, range(200))
    drawn = [draw_effects(rng, arm, wanted, scale) for rng in rngs]
    names = [[effect.name for effect in effects] for effects in drawn]
    assert {len(several) for several in names} == {0, 1, 2}
    assert {name for several in names for name in several} == set(CATALOGUE)
    assert all(len(set(several)) == len(several) for several in names)
    joints = [effect.joints for effects in drawn for effect in effects]
    assert {joint for several in joints for joint in several} == {2, 4}


def test_an_elastic_joint_without_a_rotor_is_given_one(bare_arm: NominalArm) -> None:
    loose, rotor = _draw(bare_arm, 0, names=["backlash"], count=(1, 1))
    assert (loose.name, rotor.name) == ("backlash", "armature")
    assert loose.joints == rotor.joints


def test_what_is_given_is_not_drawn_again(data_sheet_arm: NominalArm) -> None:
    given = (AppliedEffect("payload", (), {"mass": 1.0, "com": [0, 0, 0]}),)
    wanted = Randomisation(["payload", "armature"], count=(2, 2))
    rng, scale = np.random.default_rng(0), ArmScale.of(data_sheet_arm)
    (drawn,) = draw_effects(rng, data_sheet_arm, wanted, scale, given)
    assert drawn.name == "armature"


def test_same_seed_same_effects_and_motions_as_option_and_as_wrapper() -> None:
    names = ["coulomb_friction", "payload", "actuator_delay"]
    wanted = Randomisation(names, severity=(0.2, 0.8))
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
            effects.append(str(env.unwrapped.effects))
            rows += [env.step(np.zeros(7, np.float32))[0] for _ in range(10)]
        episodes.append((np.array(rows), effects))
        env.close()
    (option, drawn), (wrapped, again), (plain, none) = episodes
    np.testing.assert_array_equal(option, wrapped)
    assert drawn == again and drawn[0] != drawn[1] and none == ["()"] * 3
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
