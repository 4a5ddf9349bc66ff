"""The sequential alarm: how rarely noise sounds it, what does, and on which filters."""

from types import SimpleNamespace

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.kalman.alarm import alarm
from gapscope.ident.kalman.change_hypothesis import (
    ChangeHypothesis,
    friction_hypothesis,
    payload_hypothesis,
)
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.kalman.unscented import Unscented

LEVEL = ChangeHypothesis("level", ("level",), np.array([[1.0]]))
RATE = 25.0


def track(rng, joints=4, scale=1.0, duration=10.0):
    """White innovations of a filter whose noise is misstated by ``scale``, one parameter that shows on every joint."""
    t = np.arange(round(duration * RATE)) / RATE
    innovation = scale * rng.standard_normal((len(t), joints))
    return SimpleNamespace(
        t=t, innovation=innovation, whitened=np.ones((len(t), joints, 1))
    )


@pytest.mark.parametrize("scale", [0.1, 1.0, 30.0])
def test_noise_sounds_it_as_rarely_as_asked_for_whatever_its_size(scale):
    rng = np.random.default_rng(0)
    heard = [
        alarm(track(rng, scale=scale), LEVEL, false_alarms=0.01).time
        for _ in range(100)
    ]
    assert sum(time is not None for time in heard) <= 3


def test_what_shows_on_several_joints_sounds_it():
    given = track(np.random.default_rng(1))
    given.innovation[given.t > 6.0] += 3.0
    assert 6.0 <= alarm(given, LEVEL).time < 6.5


def test_what_shows_on_one_joint_alone_does_not():
    given = track(np.random.default_rng(1))
    given.innovation[given.t > 6.0, 2] += 30.0
    assert alarm(given, LEVEL).time is None


def test_an_arm_of_two_joints_has_none_to_leave_out():
    given = track(np.random.default_rng(1), joints=2)
    given.innovation[given.t > 6.0, 1] += 30.0
    assert 6.0 <= alarm(given, LEVEL).time < 6.5


def test_what_comes_later_changes_nothing():
    given = track(np.random.default_rng(2))
    before = alarm(given, LEVEL).statistic
    given.innovation[given.t > 8.0] *= 50.0
    assert np.array_equal(
        alarm(given, LEVEL).statistic[given.t <= 8.0], before[given.t <= 8.0]
    )


@pytest.mark.slow
def test_the_unscented_filter_hears_a_pick_up_too(world):
    names = ("m3", "mx3", "my3", "mz3")
    spread = np.array([0.3, 0.02, 0.02, 0.02])
    filtered = Unscented(
        world.regressor, names, spread, 0.1 * spread, 3e-5, np.full(3, 0.5)
    )
    hypothesis = ChangeHypothesis("payload", names, np.eye(10)[:, 6:])
    still, picked = (
        world.recorded(3, pickup=pickup, duration=6.0) for pickup in (None, (4.0, 2.0))
    )
    assert alarm(filtered.follow(still, every=5), hypothesis, window=0.3).time is None
    assert (
        4.0
        <= alarm(filtered.follow(picked, every=5), hypothesis, window=0.3).time
        < 4.5
    )


def test_friction_that_the_model_lacks_on_one_joint_does_not_sound_it(world):
    from gapscope.effects.applied import AppliedEffect

    stribeck = AppliedEffect(
        "stribeck_friction", (2,), {"torque": [2.0], "velocity": [0.1]}
    )
    recording = world.recorded(5, effects=(stribeck,))
    problem, t = world.assembly([recording]), world.assembly.times(recording)
    assert (
        alarm(
            Recursive(0.1 * np.ones(3)).follow(problem, t),
            payload_hypothesis(world.base, 3),
        ).time
        is None
    )


def test_friction_of_a_joint_without_columns_is_refused(world):
    with pytest.raises(InputError, match="joint 9"):
        friction_hypothesis(world.base, 9)


@pytest.mark.parametrize("seed", range(3))
def test_a_payload_picked_up_is_heard(world, seed):
    rng = np.random.default_rng(100 + seed)
    moment, mass = rng.uniform(2.5, 5.5), rng.uniform(0.5, 3.0)
    recording = world.recorded(seed, pickup=(moment, mass))
    problem, t = world.assembly([recording]), world.assembly.times(recording)
    track = Recursive(0.1 * np.ones(3)).follow(problem, t)
    heard = alarm(track, payload_hypothesis(world.base, 3))
    assert moment - 0.1 < heard.time < moment + 1.5


@pytest.mark.parametrize("seed", range(3))
def test_no_change_no_alarm(world, seed):
    stribeck = AppliedEffect(
        "stribeck_friction", (2,), {"torque": [0.5], "velocity": [0.1]}
    )
    recording = world.recorded(10 + seed, effects=(stribeck,))
    problem, t = world.assembly([recording]), world.assembly.times(recording)
    payload = payload_hypothesis(world.base, 3)
    assert alarm(Recursive(0.1 * np.ones(3)).follow(problem, t), payload).time is None


def test_an_alarm_needs_a_record_longer_than_its_settling(world):
    recording = world.recorded(1, duration=3.0)
    track = Recursive(np.ones(3)).follow(
        world.assembly([recording]), world.assembly.times(recording)
    )
    with pytest.raises(InputError, match="ends before an alarm"):
        alarm(track, payload_hypothesis(world.base, 3), settle=5.0)
