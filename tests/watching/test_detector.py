"""What a detector says of an arm on which something changes, and how much it remembers."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.dynamics.rigid_body import ArrayCache
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.detector import (
    ALARM,
    BLOCK,
    DRIFT,
    MISFIT,
    NOTE,
    NOW,
    WARM,
    Detector,
    Event,
)

LEARNING, SECONDS = 20.0, 62.0
BEFORE = 40.0
"""Nothing has changed yet: all tests go on from here [s]."""
NIGHT = 43_200.0


Hear = Callable[..., list[Event]]


@pytest.fixture(scope="module")
def hear(at_work: Any) -> Hear:
    """Events of a recording: those of its begin, which is that of all, those of the rest, and of what comes after."""
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    before = list(detector.add(at_work.recording(BEFORE)))

    def events(recording: Recording, *more: Recording) -> list[Event]:
        rest, own = recording.part(recording.t >= BEFORE), deepcopy(detector)
        return [*before, *(e for part in (rest, *more) for e in own.add(part))]

    return events


def alarms(events: list[Event]) -> list[Event]:
    return [e for e in events if e.event == ALARM]


def named(event: Event) -> tuple[str, str, tuple[int, ...]]:
    return event.effect, event.change, tuple(event.joints)


def test_healthy_arm_raises_no_alarm(at_work: Any, hear: Hear) -> None:
    found = hear(at_work.recording(80.0))
    assert [e.event for e in found] == [NOTE]
    assert "learnt 20 s" in found[0].sentence


def test_load_is_named_with_its_mass(at_work: Any, hear: Hear) -> None:
    both = at_work.recording(SECONDS, load=2.0)
    # found when another recording has begun, and told by the clock of its own
    later = both.part(both.t >= 52.0, name="later.csv")
    later = replace(later, t=later.t - later.t[0])
    (found,) = alarms(hear(both.part(both.t < 52.0), later))
    mass = found.sizes["mass"]
    assert found.recording == both.name and found.detected > 52.0
    assert named(found) == ("payload", "picked up", ())
    assert mass.value == pytest.approx(2.0, abs=3 * mass.std)
    assert mass.std < 0.4
    assert abs(found.time - at_work.change) < 3.0
    assert found.interval[0] <= at_work.change <= found.interval[1]


@pytest.mark.nightly
def test_friction_is_named_with_its_joint(at_work: Any, hear: Hear) -> None:
    (found,) = alarms(hear(at_work.recording(SECONDS, friction=1.8)))
    assert named(found) == ("friction", "risen", (2,))
    size = found.sizes["torque_at_usual_speed"]
    assert size.value > 4 * size.std


def test_friction_that_rises_evenly_is_dated_from_begin_to_end(
    at_work: Any, hear: Hear
) -> None:
    found = hear(at_work.recording(74.0, friction=2.5, rising=16.0))
    first, over = [e for e in found if e.event != NOTE]
    assert (first.event, over.event) == (ALARM, DRIFT)
    assert named(first) == named(over) == ("friction", "risen", (2,))
    assert first.until is None
    assert "goes on" in first.sentence
    assert over.time == pytest.approx(at_work.change, abs=2.0)
    assert over.until == pytest.approx(at_work.change + 16.0, abs=2.0)


@pytest.mark.nightly
def test_friction_that_rises_for_longer_than_is_compared_is_no_new_alarm_each_time(
    at_work: Any,
) -> None:
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    rising = replace(at_work, change=30.0)
    found = list(detector.add(rising.recording(80.0, friction=1.7, rising=100.0)))
    first = next(e.time for e in found if e.event == ALARM)
    again = [e.event for e in found if e.time and abs(e.time - first) < 2.0]
    assert again == [ALARM, DRIFT]


@pytest.mark.parametrize("logged", ["date", "temperature"])
def test_arm_that_is_cold_in_the_morning_raises_no_alarm(
    at_work: Any, logged: str
) -> None:
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    both = at_work.recording(66.0, cold=0.5)
    if logged == "temperature":
        warm = 25.0 + 20.0 * (1.0 - at_work.coldness(both.t))
        both = replace(both, temperature=np.tile(warm[:, None], both.q.shape[1]))
    evening = replace(both.part(both.t < at_work.change), begun=NIGHT)
    morning = both.part(both.t >= at_work.change, name="morning.csv")
    if logged == "date":
        morning = replace(morning, begun=2 * NIGHT)
    found = [event for part in (evening, morning) for event in detector.add(part)]
    assert [event.event for event in found] == [NOTE]


def test_encoder_that_slips_is_named_by_its_reading(at_work: Any, hear: Hear) -> None:
    recording = at_work.recording(62.0)
    q = recording.q.copy()
    q[recording.t >= 42.0, 1] += 0.05
    found = hear(replace(recording, q=q))
    (alarm,) = [e for e in found if e.event != NOTE]
    assert (alarm.effect, list(alarm.joints)) == ("encoder_offset", [2])
    assert alarm.sizes["offset"].value == pytest.approx(0.05, abs=2e-3)
    assert alarm.interval[0] < 42.0 <= alarm.interval[1]


@pytest.mark.parametrize("seconds", daily((50.0, 52.0), 50.0))
def test_a_count_of_a_fine_encoder_at_rest_is_no_slip(
    seconds: float, at_work: Any, hear: Hear
) -> None:
    recording = at_work.recording(seconds)
    q, rests = recording.q.copy(), (recording.t > 42.0) & (recording.t < 48.0)
    # at rest but for one count
    q[rests, 1] = q[rests, 1][0] + 3e-7 * (recording.t[rests] > 45.0)
    late = recording.t >= 48.0
    q[late, 1] += q[rests, 1][-1] - q[late, 1][0]
    found = hear(replace(recording, q=q))
    assert not [e for e in found if e.effect == "encoder_offset"]


def test_what_no_name_fits_is_something_else(at_work: Any, hear: Hear) -> None:
    shaking = 3 * float(at_work.arm.coulomb[0])
    (found,) = alarms(hear(at_work.recording(SECONDS, shaking=shaking)))
    assert (found.effect, list(found.joints)) == ("other", [1])
    assert found.evidence["growth_1"] > 2


def test_change_without_a_name_is_a_misfit_and_no_alarm(
    at_work: Any, hear: Hear
) -> None:
    later = replace(at_work, change=90.0)
    found = [e for e in hear(later.recording(116.0, late=0.03)) if e.event != NOTE]
    assert [e.event for e in found] == [MISFIT]
    assert abs(found[0].time - later.change) < 5.0
    assert found[0].sizes == {}
    assert found[0].interval is None


def test_what_a_diagnosis_found_is_taken_out_but_for_pushes(at_work: Any) -> None:
    arm, recording = CorrectedArm(at_work.arm), at_work.recording(15.0)
    times = {"start": np.array(0.0), "end": np.array(9.0)}
    force = {"force": np.array([0.0, 0.0, -20.0]), **times}
    push = AppliedEffect("external_force", (), force)
    lacking = np.zeros((at_work.arm.n_joints, 10))
    lacking[-1, 0] = 1.0
    torque = []
    for known in (arm, replace(arm, effects=(push,)), replace(arm, remainder=lacking)):
        detector = Detector(known, learning=LEARNING)
        list(detector.add(recording))
        torque.append(detector.state.seen[0].segment.recorded_torque)
    plain, pushed, lighter = torque
    assert np.allclose(pushed, plain)
    assert np.abs(lighter - plain).max() > 0.1


def test_a_slip_in_what_is_learnt_is_told_and_ends_with_its_recording(
    at_work: Any,
) -> None:
    recording = at_work.recording(40.0)
    q = recording.q.copy()
    q[recording.t >= 38.0, 1] += 0.05
    detector = Detector(CorrectedArm(at_work.arm), learning=0.0)
    slip, learnt = detector.learn_from([replace(recording, q=q)])
    assert (slip.event, learnt.event) == (NOTE, NOTE)
    assert "joint 2" in slip.sentence and "learnt" in learnt.sentence
    assert np.all(detector.stream.slipped == 0.0)


def test_joints_cool_down_to_where_they_were_measured(at_work: Any) -> None:
    """Over a night, by an estimate that goes on from temperatures of an earlier log."""
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    recording = replace(at_work.recording(8.0), begun=NIGHT)
    measured = np.full(recording.q.shape, 55.0)
    morning = replace(recording, name="morning.csv", begun=2 * NIGHT)
    for part in (replace(recording, temperature=measured), morning):
        list(detector.add(part))
    cold = detector.state.blocks[-1].segment.temperature
    assert cold is not None
    assert np.allclose(cold, 55.0 - WARM, atol=2.0)


@pytest.mark.nightly
def test_memory_does_not_grow_with_the_stream(
    at_work: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for results that are kept for whoever asks again: these grow up to a bound of their own, of 64 MiB."""
    monkeypatch.setattr(ArrayCache, "get", lambda *given: given[-1]())
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    peaks = []
    tracemalloc.start()
    try:
        for part in range(20):
            list(detector.add(at_work.recording(10.0, start=10.0 * part)))
            peaks.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # 20 s of learning, and 60 s until what is compared is full
    assert max(peaks[12:]) < 1.1 * max(peaks[:12])
    assert len(detector.state.now) * BLOCK <= NOW


@pytest.mark.nightly
def test_joint_that_rested_while_learning_raises_no_alarm(at_work: Any) -> None:
    detector = Detector(CorrectedArm(at_work.arm), learning=LEARNING)
    resting = at_work.recording(30.0)
    working = at_work.recording(60.0, start=30.0)
    q = resting.q.copy()
    q[:, 2] = working.q[0, 2]
    resting = replace(resting, q=q)
    found = [event for part in (resting, working) for event in detector.add(part)]
    assert "J3 rested" in found[0].sentence
    assert [e.effect for e in found if e.event == ALARM and 3 in e.joints] == []
