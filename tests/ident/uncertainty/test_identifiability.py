"""What a motion can tell: rank, condition and warnings, and the reduction to essential parameters."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cases import each, panda_case
from sweeps import daily

from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identifiability,
    identify,
)
from gapscope.ident.model.base_parameters import (
    BaseParameters,
    Factor,
    essential_parameters,
    random_states,
    structural_base,
)
from gapscope.ident.model.regressor import Regressor

QUANTITIES = ("rotor", "damping")


@pytest.fixture(scope="module")
def iiwa():
    regressor = Regressor(load_nominal_arm("kuka_iiwa"), quantities=QUANTITIES)
    base = structural_base(regressor, np.random.default_rng(0))
    return regressor, base, random_states(regressor, np.random.default_rng(1), 200)


def test_joint_that_rests_is_named_with_a_remedy(iiwa):
    regressor, base, states = iiwa
    moving = np.array([1, 1, 1, 1, 1, 1, 0])
    poor = Motion(states.t, states.q * moving, states.dq * moving, states.ddq * moving)
    found = identifiability(regressor.matrix(poor), base)
    assert found.rank < found.structural
    assert "record a motion that moves every joint" in found.warnings[0]
    assert f"determine only {found.rank} of {base.count}" in found.warnings[0]


def test_two_columns_that_nearly_coincide_raise_a_warning_that_names_them():
    rng = np.random.default_rng(2)
    W = rng.standard_normal((300, 4))
    W[:, 3] = W[:, 1] + 1e-4 * W[:, 3]
    base = BaseParameters(tuple("abcd"), np.arange(4), np.eye(4))
    found = identifiability(W, base)
    assert found.rank == 4
    assert 1e4 < found.condition < 3e4
    assert set(found.weakest) == {"b", "d"}
    assert (
        "above 1000" in found.warnings[0] and "cannot be separated" in found.warnings[0]
    )


BETA = np.array([5.0, 0.0, 2.0, 1e-4, 1.0])


@pytest.fixture
def factor():
    rng = np.random.default_rng(4)
    W = rng.standard_normal((4000, 5))
    return Factor.of(W, W @ BETA + 0.05 * rng.standard_normal(4000))


def test_parameters_without_content_are_dropped_and_the_others_kept(factor):
    found = essential_parameters(factor, tuple("abcde"))
    assert found.names == ("a", "c", "e")
    assert {step["name"] for step in found.dropped} == {"b", "d"}
    assert found.residual_growth < 0.02


# What recordings tell: rank, essential parameters, segments, intervals, and warnings of what the model lacks.


CUTOFF = IdentificationSettings(cutoff=20.0)
LOAD = AppliedEffect("load_friction", (2, 4), {"coefficient": np.array([0.15, 0.15])})
LACKS = "lacks an effect"


@cache
def healthy() -> Identification:
    return identify(panda_case(count=4, duration=5.0), CUTOFF)


def warned(result: Identification) -> bool:
    return any(LACKS in warning for warning in result.warnings)


@pytest.mark.parametrize("seed", daily((1, 2), 1))
def test_an_effect_that_the_model_lacks_is_warned_of(seed: int) -> None:
    assert warned(identify(panda_case((LOAD,), seed, duration=5.0), CUTOFF))


def test_healthy_arm_is_shown_whole_and_essential_parameters_explain_its_torque() -> (
    None
):
    found, shown, essential = healthy(), healthy().determined, healthy().essential
    assert not warned(found)
    assert shown.rank == shown.structural == found.base.count == 69
    assert shown.condition == pytest.approx(found.condition, rel=1e-3)
    assert found.groups is not None and found.groups.verdict == "noise"
    assert found.reasons == ()
    assert essential is not None
    assert {f"c{j}" for j in range(1, 8)} <= set(essential.names)
    assert essential.residual_growth <= 0.021


def test_few_samples_are_said() -> None:
    result = identify(each(panda_case(), lambda r: r.part(slice(425))), CUTOFF)
    assert result.counted.per_parameter < 2
    (warning,) = (w for w in result.warnings if "independent samples" in w)
    assert "10 are advised" in warning and "record for" in warning
    assert not any("independent samples" in w for w in healthy().warnings)
