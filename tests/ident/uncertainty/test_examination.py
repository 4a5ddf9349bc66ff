"""What recordings tell: rank, essential parameters, segments, intervals, and warnings of what the model lacks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import each, panda_case
from sweeps import daily

from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)

CUTOFF = IdentificationSettings(cutoff=20.0)
LOAD = AppliedEffect("load_friction", (2, 4), {"coefficient": np.array([0.15, 0.15])})
LACKS = "lacks an effect"


@cache
def healthy() -> Identification:
    return identify(panda_case(count=4), CUTOFF)


def warned(result: Identification) -> list[str]:
    return [warning for warning in result.warnings if LACKS in warning]


@pytest.mark.nightly
def test_healthy_arm_is_told_apart_from_one_with_load_friction() -> None:
    assert not warned(healthy())
    (warning,) = warned(identify(panda_case((LOAD,), count=4), CUTOFF))
    joints = warning[: warning.index(" is not noise")].split("joint ")[1].split(", ")
    assert {"2", "4"} <= set(joints)


@pytest.mark.parametrize("seed", daily((1, 2), 1))
def test_other_recordings(seed: int) -> None:
    assert not warned(identify(panda_case(seed=seed), CUTOFF))
    assert warned(identify(panda_case((LOAD,), seed=seed), CUTOFF))


def test_healthy_arm_is_shown_whole() -> None:
    examined = healthy().examined
    assert (
        examined.shown.rank == examined.shown.base.count == healthy().base.count == 69
    )
    assert examined.shown.condition == pytest.approx(healthy().condition, rel=1e-3)
    assert examined.groups is not None and examined.groups.verdict == "noise"
    assert examined.reasons == ()


def test_intervals_hold_the_recorded_torque() -> None:
    predicted = healthy().predicted
    assert predicted is not None
    assert (predicted.held > 0.9).all()
    assert (
        predicted.half_width
        < 0.1 * np.sqrt((healthy().validation[1].torque ** 2).mean(axis=0))
    ).all()


def test_essential_parameters_explain_the_torque() -> None:
    essential = healthy().examined.essential
    assert essential is not None
    assert {f"c{j}" for j in range(1, 8)} <= set(essential.names)
    assert essential.residual[1] <= 1.021 * essential.residual[0]


@pytest.mark.nightly
def test_a_joint_that_rests_costs_rank_and_is_said() -> None:
    def resting(r: Recording) -> Recording:
        return replace(r, q=np.where(np.arange(7) == 6, 0.3, r.q))

    result = identify(each(panda_case(), resting), CUTOFF)
    shown = result.examined.shown
    assert shown.rank == result.base.count < shown.base.count == 69
    assert any(
        f"determine only {shown.rank} of 69 base parameters" in warning
        for warning in result.warnings
    )


def test_few_samples_are_said() -> None:
    short = each(
        panda_case(),
        lambda r: replace(r, t=r.t[:425], q=r.q[:425], tau=np.asarray(r.tau)[:425]),
    )
    result = identify(short, CUTOFF)
    assert result.examined.counted.per_parameter < 2
    (warning,) = (w for w in result.warnings if "independent samples" in w)
    assert "10 are advised" in warning and "record for" in warning
    assert not any("independent samples" in w for w in healthy().warnings)
