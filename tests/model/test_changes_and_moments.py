"""What changes during a recording, and when, on a three-joint arm that is believed with a poor URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.synthetic import Truth, recordings, vendor
from sweeps import nightly

from gapscope.arm.recording import Recording
from gapscope.model.changes import Change, changes_of

HEALTHY = Truth(offset=(0.6, -0.5, 0.2))
"""Torque offsets that the arm has from the first to the last sample [N m]."""
MOMENT = 5.3
"""When something changes [s]."""
CHANGED = {
    ("payload", 0): (replace(HEALTHY, mass=1.0, com=(0.1, 0.0, 0.0)), 1.0),
    ("coulomb_friction", 2): (replace(HEALTHY, coulomb=(0.0, 1.5, 0.0)), 1.5),
    ("torque_scale", 2): (replace(HEALTHY, scale=(0.0, 0.15, 0.0)), 0.15),
}
"""Effect and joint that change: the arm then, and the first coordinate of the change."""


def changing(
    later: Truth, start: float, end: float = np.inf
) -> tuple[Recording, Recording]:
    """Two recordings, in the second of which the arm is another one between two moments."""
    one, before = recordings(HEALTHY, 1, duration=9.0)[:2]
    after = recordings(later, 1, duration=9.0)[1]
    there = ((before.t >= start) & (before.t < end))[:, None]
    q = np.where(there, after.q, before.q)
    tau = np.where(there, np.asarray(after.tau), np.asarray(before.tau))
    return one, replace(before, q=q, tau=tau)


def found(later: Truth, start: float, end: float = np.inf) -> tuple[Change, ...]:
    return changes_of(changing(later, start, end), vendor()).during


def test_nothing_changes() -> None:
    assert found(HEALTHY, MOMENT) == ()


@pytest.mark.parametrize("what", CHANGED, ids=lambda what: what[0])
def test_what_changes_when_and_by_how_much(what: tuple[str, int]) -> None:
    later, value = CHANGED[what]
    (change,) = found(later, MOMENT)
    assert (change.term.effect, change.term.joint) == what
    assert change.recording == recordings(HEALTHY, 1)[1].name
    assert change.time == pytest.approx(MOMENT, abs=0.1)
    low, high = change.interval
    assert low <= MOMENT <= high
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
    one, before = recordings(HEALTHY, 1, duration=9.0)[:2]
    after = recordings(later, 1, duration=9.0)[1]
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
    one, before = recordings(HEALTHY, 1, duration=9.0)[:2]
    stiff, _ = CHANGED["coulomb_friction", 2]
    cold = recordings(stiff, 1, duration=9.0)[1]
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


@pytest.mark.parametrize("joint", [1, 2])
def test_an_encoder_that_slips(joint: int) -> None:
    one, before = recordings(HEALTHY, 1, duration=9.0)[:2]
    q = before.q.copy()
    q[before.t >= MOMENT, joint - 1] += np.radians(2.0)
    (change,) = changes_of((one, replace(before, q=q)), vendor()).during
    assert (change.term.effect, change.term.joint) == ("encoder_offset", joint)
    assert change.time == pytest.approx(MOMENT, abs=0.01)
    low, high = change.interval
    assert low <= MOMENT <= high and high - low < 0.02
    assert change.value[0] == pytest.approx(np.radians(2.0), rel=0.01)
