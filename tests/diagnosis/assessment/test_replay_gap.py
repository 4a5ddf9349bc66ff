"""The replay gap of a diagnosis: it shrinks with the effects found, and is null with a warning where it fails."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.replay_gap import attempt, replay_gap
from gapscope.diagnosis.thresholds import REPLAYED_TICKS
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case
from gapscope.model.terms import Terms

PAYLOAD = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.02, 0.06]})
WRONG = AppliedEffect("payload", (), {"mass": 30.0, "com": [0.0, 0.02, 0.06]})


@pytest.fixture(scope="module")
def case() -> Case:
    return record_case(
        "loaded",
        iiwa(),
        (PAYLOAD,),
        Plan(recordings=2, duration=2.0),
        np.random.default_rng(1),
    )


def _predictor(
    case: Case, set_aside: bool = False, start: float = 0.0
) -> SimpleNamespace:
    """What ``replay_gap`` asks of a predictor: the right values are those fitted to what it must not replay."""
    evidence = SimpleNamespace(
        fit=lambda terms: SimpleNamespace(theta=PAYLOAD if set_aside else WRONG),
        without_last=lambda terms: WRONG if set_aside else PAYLOAD,
        terms=SimpleNamespace(
            clipped=lambda theta: theta,
            effects=lambda theta, terms: (theta,) if terms else (),
        ),
    )
    folds = [
        [SimpleNamespace(recording=r.name, motion=SimpleNamespace(t=r.t[r.t >= start]))]
        for r in case.recordings
    ]
    found = SimpleNamespace(
        evidence=evidence, fit=SimpleNamespace(terms=frozenset(Terms(7).of("payload")))
    )
    return SimpleNamespace(
        set_aside=["some"] if set_aside else [], folds=folds, selection=found
    )


def test_the_effects_found_close_it(case: Case) -> None:
    found = replay_gap(case, _predictor(case))
    assert found.warnings == () and found.before.shape == (7,)
    assert found.after.max() < 1e-3 and found.after.mean() < 0.05 * found.before.mean()


def test_the_only_effect_alone_closes_what_all_do_and_without_it_nothing_is_closed(
    case: Case,
) -> None:
    found = replay_gap(case, _predictor(case))
    assert list(found.only) == list(found.without) == ["payload"]
    np.testing.assert_array_equal(found.only["payload"], found.after)
    np.testing.assert_array_equal(found.without["payload"], found.before)


def test_another_engine_says_the_same(case: Case) -> None:
    pytest.importorskip("mujoco")
    found = replay_gap(case, _predictor(case))
    before, after = found.elsewhere["mujoco"]
    np.testing.assert_allclose(before, found.before, rtol=0.02, atol=2e-5)
    assert after.mean() < 0.05 * before.mean()


def test_a_recording_set_aside_is_replayed_with_values_fitted_to_all_others(
    case: Case,
) -> None:
    apart = replace(case, judged=case.recordings[:1])
    found = replay_gap(apart, _predictor(apart, set_aside=True))
    assert found.after.mean() < 0.05 * found.before.mean()


def test_a_block_of_a_recording_is_replayed_alone(case: Case) -> None:
    whole, block = (
        replay_gap(case, _predictor(case, start=start)) for start in (0.0, 1.0)
    )
    assert not np.allclose(whole.before, block.before)
    assert block.after.mean() < 0.05 * block.before.mean()


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
    through, driven = (
        replay_gap(case, _predictor(case)),
        replay_gap(less, _predictor(case)),
    )
    assert (through.by, driven.by) == ("controller", "torque")
    assert not driven.warnings and driven.after.mean() < 0.5 * driven.before.mean()


def test_an_arm_that_runs_away_is_null_with_a_warning(case: Case) -> None:
    assert case.controller is not None
    gains = replace(case.controller, kp=np.full(7, 1e8))
    found = replay_gap(
        replace(case, arm=replace(case.arm, torque_limit=None), controller=gains),
        _predictor(case),
    )
    assert found.before is None and found.after is None
    assert [
        "nominal arm" in found.warnings[0],
        "corrected arm" in found.warnings[1],
    ] == [True, True]
    assert all("diverged" in warning for warning in found.warnings)


def test_an_effect_that_cannot_be_simulated_is_explained(case: Case) -> None:
    lighter = AppliedEffect("armature", (1,), {"inertia": [-0.9]})
    found, why, _ = attempt(case, (lighter,), case.recordings[0])
    assert found is None and why is not None and "armature" in why


def test_time_is_bounded(case: Case) -> None:
    """Only so many ticks of the controller are replayed: a fast controller sees a shorter part."""
    assert case.controller is not None
    fast = replace(case, controller=replace(case.controller, rate=REPLAYED_TICKS / 0.5))
    assert "0.5 s" in replay_gap(fast, _predictor(case)).warnings[0]
