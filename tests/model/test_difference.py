"""What one group of recordings has that another has not, on a three-joint arm that is believed with a poor URDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from sweeps import daily, nightly
from synthetic import COULOMB, Truth, motion, recording, recordings, vendor

from gapscope.arm.recording import Recording
from gapscope.model.changes import Change, changes_of, own_of_units
from gapscope.model.design import design, fitted_arm
from gapscope.model.difference import Difference, Search, is_within
from gapscope.model.equations import Equations, learn
from gapscope.model.rows import MIN_MOTIONS, Rows
from gapscope.model.terms import Terms

HEALTHY = Truth(offset=(0.6, -0.5, 0.2))
"""Torque offsets that the arm has on both days, from the first to the last sample [N m]."""
DAYS = 0.15
"""Share by which friction differs from day to day at most [1]."""


@cache
def day(truth: Truth, seed: int):
    return recordings(truth, seed, duration=6.0)


def changed(truth: Truth, healthy: Truth = HEALTHY, times: int = 1) -> Difference:
    """What a day has that the day before has not; each recording listed so many times."""
    return between(times * list(day(healthy, 1)), times * list(day(truth, 2)))


def between(one: list[Recording], other: list[Recording]) -> Difference:
    """What the other group of recordings has."""
    rows = Rows.recorded([one, other])
    return Search(rows, fitted_arm(rows, vendor(), {0}), [(1,)], {0}, DAYS).run()


def named(found: Difference) -> dict[tuple[str, int], np.ndarray]:
    return {(one.effect, one.term.joint): x for one, x in found.fit.values.items()}


@pytest.mark.parametrize(
    ("truth", "name", "joint", "value"),
    [
        nightly({"coulomb": (0.0, 2.4, 0.0)}, "coulomb_friction", 2, 2.4),
        nightly({"tilt": (0.05, 0.0)}, "base_tilt", 0, 0.05),
        ({"delay": (0.0, 0.0, 0.015)}, "actuator_delay", 3, 0.015),
    ],
)  # fmt: skip
def test_one_effect_that_came(truth, name, joint, value):
    found = named(changed(replace(HEALTHY, **truth)))
    assert list(found) == [(name, joint)]
    assert found[name, joint][0] == pytest.approx(value, rel=0.15)


def test_two_effects_that_came():
    truth = replace(HEALTHY, mass=1.0, com=(0.05, 0.0, 0.1), scale=(0.15, 0.0, 0.0))
    found = named(changed(truth))
    assert set(found) == {("payload", 0), ("torque_scale", 1)}


@pytest.mark.nightly
def test_what_both_days_have_is_no_difference():
    more = {"load": (0.0, 0.1, 0.0), "ripple": (0.0, 0.5, 0.0)}
    both = replace(HEALTHY, **more, scale=(0.0, 0.0, 0.2))
    assert not named(changed(both, both))


def test_one_unit_has_something_of_its_own():
    odd = replace(HEALTHY, scale=(0.0, 0.15, 0.0))
    units = {f"arm {k}": list(day(HEALTHY, k)) for k in (1, 2)}
    (found,) = own_of_units(units | {"arm 3": list(day(odd, 3))}, vendor(), DAYS)
    assert (found["unit"], found["what"]) == ("arm 3", "torque_scale")
    assert found["joints"] == [2]
    assert found["parameters"]["scale"]["value"] == pytest.approx(0.15, rel=0.15)


Times = Callable[[np.ndarray], tuple[np.ndarray, Any, Any]]


class Retimed:
    """A motion by another clock, which gives time and its two derivatives by t."""

    def __init__(self, seed: int, duration: float, clock: Times, of: float) -> None:
        self.duration, self._clock = duration, clock
        self._going = motion(seed, duration=of)

    def position(self, t: np.ndarray) -> np.ndarray:
        return self._going.position(self._clock(t)[0])

    def velocity(self, t: np.ndarray) -> np.ndarray:
        time, rate, _ = self._clock(t)
        return (self._going.velocity(time).T * rate).T

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        time, rate, gain = self._clock(t)
        by_rate = self._going.acceleration(time).T * rate**2
        return (by_rate + self._going.velocity(time).T * gain).T


def stopping(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stops for 0.6 s in every 2 s."""
    x = np.clip((t % 2.0) / 1.4, 0.0, 1.0)
    time = 2.0 * (t // 2.0 + x**3 * (10.0 - 15.0 * x + 6.0 * x**2))
    rate = 2.0 * 30.0 * (x * (1.0 - x)) ** 2 / 1.4
    return time, rate, 2.0 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / 1.4**2


def test_friction_that_holds_a_joint_is_no_difference():
    def holding(t, q, dq):
        stop = np.sin(5.0 * (t // 2.0)[:, None] + np.arange(3))
        return COULOMB * stop * (1.0 - np.abs(np.tanh(dq / 0.005)))

    rng, truth = np.random.default_rng(3), replace(HEALTHY, extra=holding)
    moved = [Retimed(seed, 12.0, stopping, of=12.0) for seed in (4, 5)]
    stops = [recording(truth, m, rng, f"stops{k}") for k, m in enumerate(moved)]
    assert not named(between(list(day(HEALTHY, 1)), stops))


def test_a_vibration_counts_as_noise_at_its_own_frequency():
    def shaking(t, q, dq):
        return np.outer(np.sin(40.0 * t), [0.0, 4.0, 0.0])

    rows = Rows.recorded([list(day(replace(HEALTHY, extra=shaking), 2))])
    error = learn(Equations.of(design(rows, fitted_arm(rows, vendor(), {0}), {})), {0})
    counted_once = error.noise2 / error.white2
    assert counted_once[1] > 2.5 * max(counted_once[0], counted_once[2])


@pytest.mark.nightly
def test_recordings_listed_ten_times_add_nothing():
    truth = replace(HEALTHY, coulomb=(0.0, 0.8 * COULOMB[1], 0.0))
    once, often = changed(truth), changed(truth, times=10)
    assert named(often).keys() == named(once).keys()
    assert often.sets.keys() == once.sets.keys()
    assert max(abs(often.sets[k] - once.sets[k]) for k in once.sets) < 1e-6


def test_a_torque_that_no_effect_makes_is_unknown():
    def extra(t, q, dq):
        wave = np.sin(9 * q[:, 0]) * np.cos(7 * q[:, 1]) * np.sin(3 * t)
        return 2.0 * wave[:, None] * np.array([0.0, 1.0, 0.0])

    found = changed(replace(HEALTHY, extra=extra))
    assert 1 in {joint for joint, *_ in found.fit.grown}


def test_a_cycle_in_one_recording_is_one_motion():
    """A motion that comes again every 5 s."""
    cycle = Retimed(4, 30.0, lambda t: (t + 10.0, 1.0, 0.0), of=60.0)
    logged = recording(HEALTHY, cycle, np.random.default_rng(6), "cycle")
    rows = Rows.recorded([[logged]])
    first = rows.t < rows.t[0] + 4.9
    later = np.searchsorted(rows.t, rows.t[first] + 5.0)
    assert (rows.motion[later] == rows.motion[first]).mean() > 0.95
    assert len(np.unique(rows.motion)) == MIN_MOTIONS


def test_motions_are_the_same_in_whatever_order_recordings_are_listed() -> None:
    listed = list(day(HEALTHY, 1))
    one, other = Rows.recorded([listed]), Rows.recorded([listed[::-1]])
    for k in range(len(listed)):
        mine = one.motion[one.recording == k]
        assert np.array_equal(mine, other.motion[other.recording == 2 - k])


# What changes during a recording, and when, on a three-joint arm that is believed with a poor URDF.


MOMENT = 5.3
"""When something changes [s]."""
CHANGED = {
    ("payload", 0): (replace(HEALTHY, mass=1.0, com=(0.1, 0.0, 0.0)), 1.0),
    ("coulomb_friction", 2): (replace(HEALTHY, coulomb=(0.0, 1.5, 0.0)), 1.5),
    ("torque_scale", 2): (replace(HEALTHY, scale=(0.0, 0.25, 0.0)), 0.25),
}
"""Effect and joint that change: the arm then, and the first coordinate of the change."""


def nine_seconds(truth: Truth) -> tuple[Recording, Recording]:
    """Two recordings of an arm."""
    one, other, _ = recordings(truth, 1, duration=9.0)
    return one, other


def changing(
    later: Truth, start: float, end: float = np.inf
) -> tuple[Recording, Recording]:
    """Two recordings, in the second of which the arm is another one between two moments."""
    (one, before), (_, after) = nine_seconds(HEALTHY), nine_seconds(later)
    there = ((before.t >= start) & (before.t < end))[:, None]
    q = np.where(there, after.q, before.q)
    tau = np.where(there, np.asarray(after.tau), np.asarray(before.tau))
    return one, replace(before, q=q, tau=tau)


def found(later: Truth, start: float, end: float = np.inf) -> tuple[Change, ...]:
    return changes_of(changing(later, start, end), vendor()).during


def test_what_changes_when_and_by_how_much() -> None:
    """In a recording that goes on where another log ended: by its own clock."""
    what = "torque_scale", 2
    later, value = CHANGED[what]
    one, changed = changing(later, MOMENT)
    changed = replace(changed, t=20.0 + changed.t)
    (change,) = changes_of((one, changed), vendor()).during
    assert (change.term.effect, change.term.joint) == what
    assert change.recording == changed.name
    assert change.time == pytest.approx(20.0 + MOMENT, abs=0.1)
    low, high = change.interval
    assert low <= 20.0 + MOMENT <= high
    times, _ = change.columns[changed.name]
    assert changed.t[0] <= times[0] < times[-1] <= changed.t[-1]
    assert change.value[0] == pytest.approx(value, rel=0.15)
    assert change.probability > 0.9 and change.support > 1.0
    assert change.until is None


@pytest.mark.nightly
def test_a_load_that_is_picked_up_and_put_down() -> None:
    later, mass = CHANGED["payload", 0]
    up, down = found(later, 3.1, 6.4)
    assert [c.term.effect for c in (up, down)] == ["payload", "payload"]
    assert up.time == pytest.approx(3.1, abs=0.1)
    assert down.time == pytest.approx(6.4, abs=0.1)
    assert up.value[0] == pytest.approx(mass, rel=0.1)
    assert down.value[0] == pytest.approx(-mass, rel=0.1)


@pytest.mark.parametrize(
    ("what", "begin", "end"),
    [
        (("coulomb_friction", 2), 4.0, 5.0),
        nightly(("coulomb_friction", 2), 1.0, 8.5),
        nightly(("torque_scale", 2), 2.0, 7.0),
    ],
)
def test_what_rises_evenly_is_one_change_that_takes_a_while(
    what: tuple[str, int], begin: float, end: float
) -> None:
    later, value = CHANGED[what]
    (one, before), (_, after) = nine_seconds(HEALTHY), nine_seconds(later)
    risen = np.clip((before.t - begin) / (end - begin), 0.0, 1.0)[:, None]
    tau = before.tau + risen * (after.tau - before.tau)
    (change,) = changes_of((one, replace(before, tau=tau)), vendor()).during
    assert (change.term.effect, change.term.joint) == what
    assert change.time == pytest.approx(begin, abs=0.7)
    assert change.until == pytest.approx(end, abs=0.7)
    assert change.value[0] == pytest.approx(value, rel=0.15)
    assert f"from {change.time:.2f} to {change.until:.2f} s" in str(change)


def warming() -> tuple[Recording, Recording]:
    """A recording of a warm arm, and one in which 1.5 N m of friction go while it warms up."""
    stiff, _ = CHANGED["coulomb_friction", 2]
    (one, before), (_, cold) = nine_seconds(HEALTHY), nine_seconds(stiff)
    risen = np.clip((before.t - 3.0) / 4.0, 0.0, 1.0)[:, None]
    tau = cold.tau + risen * (before.tau - cold.tau)
    warmth = 20.0 + 30.0 * risen * np.ones((1, 3))
    return (
        replace(one, temperature=50.0 + 0.0 * one.q),
        replace(before, tau=tau, temperature=warmth),
    )


def test_friction_that_follows_its_temperature_is_no_change() -> None:
    assert changes_of(warming(), vendor()).during == ()


@pytest.mark.nightly
def test_without_the_temperature_it_is_one() -> None:
    unlogged = [replace(one, temperature=None) for one in warming()]
    found = changes_of(unlogged, vendor()).during
    assert any((c.term.effect, c.term.joint) == ("coulomb_friction", 2) for c in found)


def test_what_changes_at_the_last_moment_is_no_error() -> None:
    later, _ = CHANGED["payload", 0]
    assert all(c.time > 8.0 for c in found(later, 8.9))


@pytest.mark.parametrize("joint", daily((1, 2), 1))
def test_an_encoder_that_slips(joint: int) -> None:
    one, before = nine_seconds(HEALTHY)
    q = before.q.copy()
    q[before.t >= MOMENT, joint - 1] += np.radians(2.0)
    (change,) = changes_of((one, replace(before, q=q)), vendor()).during
    assert (change.term.effect, change.term.joint) == ("encoder_offset", joint)
    assert change.time == pytest.approx(MOMENT, abs=0.01)
    low, high = change.interval
    assert low <= MOMENT <= high and high - low < 0.02
    assert change.value[0] == pytest.approx(np.radians(2.0), rel=0.01)


# Values that cannot be.


@pytest.mark.parametrize(
    ("stiffness", "torque", "can_be"),
    [(5.0, 2.0, True), (-5.0, 2.0, True), (0.1, 1.0, False), (0.0, 1.0, False)],
)
def test_a_spring_that_rests_where_no_joint_can_be_cannot_be(stiffness, torque, can_be):
    """It would stand for a constant torque."""
    spring, value = Terms(3).of("parallel_spring")[1], np.array([stiffness, torque])
    assert is_within(spring, value, 0.0) == can_be
