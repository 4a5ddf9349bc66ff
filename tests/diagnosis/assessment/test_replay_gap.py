"""The replay gap of a diagnosis: it shrinks with the effects found, and is null with a warning where it fails."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, attempt, replay_gap
from gapscope.diagnosis.thresholds import REPLAYED_TICKS
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case

PAYLOAD = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.02, 0.06]})


@pytest.fixture(scope="module")
def case() -> Case:
    plan, rng = Plan(recordings=2, duration=2.0), np.random.default_rng(1)
    return record_case("loaded", iiwa(), (PAYLOAD,), plan, rng)


def replayed(case: Case) -> ReplayGap:
    """Of the last recording, with what is there."""
    return replay_gap(case, case.recordings[-1], {"payload": PAYLOAD})


@pytest.fixture(scope="module")
def whole(case: Case) -> ReplayGap:
    return replayed(case)


def test_the_effects_found_close_it(whole: ReplayGap) -> None:
    assert whole.warnings == () and whole.before.shape == (7,)
    assert whole.after.max() < 1e-3 and whole.after.mean() < 0.05 * whole.before.mean()
    # the only effect alone closes what all do, and without it nothing is closed
    assert list(whole.only) == list(whole.without) == ["payload"]
    np.testing.assert_array_equal(whole.only["payload"], whole.after)
    np.testing.assert_array_equal(whole.without["payload"], whole.before)


def test_another_engine_says_the_same(whole: ReplayGap) -> None:
    pytest.importorskip("mujoco")
    before, after = whole.elsewhere["mujoco"]
    np.testing.assert_allclose(before, whole.before, rtol=0.02, atol=2e-5)
    assert after.mean() < 0.05 * before.mean()


def test_a_part_of_a_recording_is_replayed_alone(case: Case, whole: ReplayGap) -> None:
    last = case.recordings[-1]
    part = replay_gap(case, last.part(last.t >= 1.0), {"payload": PAYLOAD})
    assert not np.allclose(whole.before, part.before)
    assert part.after.mean() < 0.05 * part.before.mean()


@pytest.mark.parametrize("unknown", ["controller", "reference"])
def test_without_controller_or_reference_the_recorded_torque_moves_the_arm(
    case: Case, whole: ReplayGap, unknown: str
) -> None:
    if unknown == "controller":
        driven = replayed(replace(case, controller=None))
    else:
        driven = replayed(each(case, lambda r: replace(r, q_ref=None)))
    assert (whole.by, driven.by) == ("controller", "torque")
    assert not driven.warnings and driven.after.mean() < 0.5 * driven.before.mean()


def test_an_arm_that_runs_away_is_null_with_a_warning(case: Case) -> None:
    assert case.controller is not None
    gains = replace(case.controller, kp=np.full(7, 1e8))
    unlimited = replace(case.arm, torque_limit=None)
    found = replayed(replace(case, arm=unlimited, controller=gains))
    assert found.before is None and found.after is None
    nominal, corrected = found.warnings
    assert "nominal arm" in nominal and "corrected arm" in corrected
    assert "diverged" in nominal and "diverged" in corrected


def test_an_effect_that_cannot_be_simulated_is_explained(case: Case) -> None:
    lighter = AppliedEffect("armature", (1,), {"inertia": [-0.9]})
    found, why, *_ = attempt(case, (lighter,), case.recordings[0])
    assert found is None and why is not None and "armature" in why


def test_time_is_bounded(case: Case) -> None:
    """Only so many ticks of the controller are replayed: a fast controller sees a shorter part."""
    assert case.controller is not None
    fast = replace(case, controller=replace(case.controller, rate=REPLAYED_TICKS / 0.5))
    assert "0.5 s" in replayed(fast).warnings[0]
