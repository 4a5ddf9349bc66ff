"""The replay gap of a diagnosis: it shrinks with the effects found, and is null with a warning where it fails."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, attempt, replay_gap
from gapscope.diagnosis.thresholds import REPLAYED_TICKS
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case

PAYLOAD = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.02, 0.06]})


@pytest.fixture(scope="module")
def case() -> Case:
    return record_case(
        "loaded",
        iiwa(),
        (PAYLOAD,),
        Plan(recordings=2, duration=2.0),
        np.random.default_rng(1),
    )


def replayed(case: Case) -> ReplayGap:
    """Of the last recording, with what is there."""
    return replay_gap(case, case.recordings[-1], {"payload": PAYLOAD})


def test_the_effects_found_close_it(case: Case) -> None:
    found = replayed(case)
    assert found.warnings == () and found.before.shape == (7,)
    assert found.after.max() < 1e-3 and found.after.mean() < 0.05 * found.before.mean()


def test_the_only_effect_alone_closes_what_all_do_and_without_it_nothing_is_closed(
    case: Case,
) -> None:
    found = replayed(case)
    assert list(found.only) == list(found.without) == ["payload"]
    np.testing.assert_array_equal(found.only["payload"], found.after)
    np.testing.assert_array_equal(found.without["payload"], found.before)


def test_another_engine_says_the_same(case: Case) -> None:
    pytest.importorskip("mujoco")
    found = replayed(case)
    before, after = found.elsewhere["mujoco"]
    np.testing.assert_allclose(before, found.before, rtol=0.02, atol=2e-5)
    assert after.mean() < 0.05 * before.mean()


def test_a_part_of_a_recording_is_replayed_alone(case: Case) -> None:
    whole, last = replayed(case), case.recordings[-1]
    part = replay_gap(case, last.part(last.t >= 1.0), {"payload": PAYLOAD})
    assert not np.allclose(whole.before, part.before)
    assert part.after.mean() < 0.05 * part.before.mean()


@pytest.mark.parametrize("unknown", ["controller", "reference"])
def test_without_controller_or_reference_the_recorded_torque_moves_the_arm(
    case: Case, unknown: str
) -> None:
    bare = tuple(replace(recording, q_ref=None) for recording in case.recordings)
    less = (
        replace(case, controller=None)
        if unknown == "controller"
        else replace(case, recordings=bare)
    )
    through, driven = replayed(case), replayed(less)
    assert (through.by, driven.by) == ("controller", "torque")
    assert not driven.warnings and driven.after.mean() < 0.5 * driven.before.mean()


def test_an_arm_that_runs_away_is_null_with_a_warning(case: Case) -> None:
    assert case.controller is not None
    gains = replace(case.controller, kp=np.full(7, 1e8))
    unlimited = replace(case.arm, torque_limit=None)
    found = replayed(replace(case, arm=unlimited, controller=gains))
    assert found.before is None and found.after is None
    assert [
        "nominal arm" in found.warnings[0],
        "corrected arm" in found.warnings[1],
    ] == [True, True]
    assert all("diverged" in warning for warning in found.warnings)


def test_an_effect_that_cannot_be_simulated_is_explained(case: Case) -> None:
    lighter = AppliedEffect("armature", (1,), {"inertia": [-0.9]})
    found, why, *_ = attempt(case, (lighter,), case.recordings[0])
    assert found is None and why is not None and "armature" in why


def test_time_is_bounded(case: Case) -> None:
    """Only so many ticks of the controller are replayed: a fast controller sees a shorter part."""
    assert case.controller is not None
    fast = replace(case, controller=replace(case.controller, rate=REPLAYED_TICKS / 0.5))
    assert "0.5 s" in replayed(fast).warnings[0]
