"""Recordings of one arm compared: what is the same, what differs, with what it goes, and what would settle it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from cases import case_of
from synthetic import COULOMB, Truth, arm, held, motion, recording, recordings

from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import Recording
from gapscope.diagnosis.agreement import (
    AGREES,
    DIFFERS,
    NOT_DETERMINED,
    Agreement,
    Covariate,
    ParameterAgreement,
    agreement,
    document,
    explain,
)

DRAWS = 20
"""Healthy arms that are compared."""
FREQUENCIES = (0.1, 0.2, 0.3)
"""Base frequency of the motions [Hz]."""


def recorded(truth: Truth, number: int, seed: int = 0) -> Recording:
    """Recording ``number`` of an arm; its motion does not depend on the arm."""
    rng = np.random.default_rng(77 + number + 10 * seed)
    moved = motion(10 * seed + number, FREQUENCIES[number], 8.0)
    return recording(truth, moved, rng, f"recording_{number}.csv")


def compared(found: Sequence[Recording]) -> Agreement:
    return agreement(case_of("arm", arm(), *found))


def unlike(other: Truth, number: int) -> Agreement:
    """Three recordings of a healthy arm but for one."""
    truths = [other if k == number else Truth() for k in range(3)]
    return compared([recorded(truth, k) for k, truth in enumerate(truths)])


def line(found: Agreement, key: str) -> ParameterAgreement:
    return next(one for one in found.parameters if one.key == key)


def differing(found: Agreement) -> list[str]:
    return [one.key for one in found.having(DIFFERS)]


@pytest.fixture(scope="module")
def same() -> Agreement:
    return unlike(Truth(), 0)


def test_the_same_arm_agrees_with_values_to_trust(same: Agreement) -> None:
    assert differing(same) == [] and same.having(NOT_DETERMINED) == ()
    for joint, truth in enumerate(COULOMB, 1):
        one = line(same, f"c{joint}")
        assert one.trusted is not None
        value, std = one.trusted
        # the healthy error of a torque constant scales friction as well
        assert value == pytest.approx(truth, rel=0.1)
        # the deviation of the mean, which scatter beyond the stated deviations widens
        precision = (one.std**-2.0).sum()
        assert std == pytest.approx(max(one.birge, 1.0) / np.sqrt(precision))


def test_document_says_what_settles_a_difference() -> None:
    """Coulomb friction of joint 2 is 30 % higher in the second of three recordings."""
    content = document(unlike(Truth(coulomb=(0.0, 0.3 * COULOMB[1], 0.0)), 1))
    first = content["parameters"][0]
    assert (first["key"], first["verdict"], first["trusted"]) == ("c2", DIFFERS, None)
    assert first["name"] == "Coulomb friction of joint 2"
    assert first["goes_with"]["recording"] == "recording_1.csv"
    assert first["settled_by"].startswith("repeat recording_1.csv")
    assert all(one["settled_by"] is None for one in content["parameters"][1:])
    assert content["level"] == 0.5


def test_friction_that_falls_with_temperature_goes_with_it() -> None:
    found = []
    for number, warmth in enumerate((35.0, 20.0, 50.0)):
        less = Truth(coulomb=(0.0, 0.04 * (35.0 - warmth), 0.0))
        one = recorded(less, number)
        found.append(replace(one, temperature=np.full(one.q.shape, warmth)))
    result = compared(found)
    assert differing(result) == ["c2"]
    entry = document(result)["parameters"][0]
    assert entry["goes_with"]["covariates"] == ["temperature"]
    assert entry["goes_with"]["shares"]["temperature"] > 0.95
    assert entry["covariates"]["temperature"]["values"] == [35.0, 20.0, 50.0]
    assert "the motion of recording_1.csv" in entry["settled_by"]
    assert "as warm as recording_2.csv" in entry["settled_by"]


LOADED = Truth(mass=1.5, com=(0.2, 0.0, 0.05))


def test_a_load_in_one_recording_is_a_load_unless_it_is_known() -> None:
    empty, loaded = [recorded(Truth(), k) for k in (0, 1)], recorded(LOADED, 2)
    result = compared([*empty, loaded])
    assert differing(result) == ["load"]
    assert line(result, "load").value == pytest.approx([0.0, 0.0, 1.5], abs=0.05)
    settled = document(result)["parameters"][0]["settled_by"]
    assert settled.startswith("repeat recording_2.csv with the empty flange")
    known = replace(loaded, payload=KnownLoad(1.5, (0.2, 0.0, 0.05)))
    assert differing(compared([*empty, known])) == []


def test_another_torque_constant_is_a_gain() -> None:
    result = unlike(Truth(scale=(0.0, 0.1, 0.0)), 2)
    assert differing(result) == ["gain2"]
    value = line(result, "gain2").value
    # the recorded torque is the needed one over 1 + s
    assert value == pytest.approx([1.0, 1.0, 1.0 / 1.1], abs=0.015)


def test_a_joint_that_rests_is_not_determined() -> None:
    moved = held(motion(2, FREQUENCIES[2], 8.0), 3)
    still = recording(Truth(), moved, np.random.default_rng(5), "still.csv")
    result = compared([recorded(Truth(), 0), still])
    assert differing(result) == []
    for key in ("c3", "b3", "gain3"):
        one = line(result, key)
        assert one.verdict == NOT_DETERMINED and one.trusted is None
        assert one.information[1] < 1.0
    assert line(result, "c3").information[0] >= 1.0
    assert line(result, "c2").verdict == AGREES
    entry = next(p for p in document(result)["parameters"] if p["key"] == "c3")
    assert entry["values"][1] is None and entry["p"] is None


def test_two_recordings_cannot_say_with_what_a_difference_goes() -> None:
    more = Truth(viscous=(0.0, 1.0, 0.0))
    result = compared([recorded(Truth(), 0), recorded(more, 2)])
    assert differing(result) == ["b2"]
    entry = document(result)["parameters"][0]
    assert entry["goes_with"]["covariates"] == []
    assert "two recordings cannot say" in entry["goes_with"]["text"]
    assert "mean speed" in entry["goes_with"]["text"]
    assert entry["settled_by"]


@pytest.mark.nightly
def test_healthy_arms_differ_no_more_often_than_stated() -> None:
    seeds = range(100, 100 + DRAWS)
    drawn = (compared(recordings(Truth(), seed, duration=5.0)) for seed in seeds)
    # at the stated rate, two alarms among so many happen in one series of fifty
    assert sum(bool(differing(found)) for found in drawn) <= 1


@pytest.mark.parametrize(
    ("value", "speed", "goes_with", "changed"),
    [
        ((1.0, 3.0, 2.0, 4.0), (0.1, 0.3, 0.2, 0.4), {"speed"}, {"speed", "order"}),
        # what changes together is not told apart
        ((1.0, 2.0, 3.0, 4.0), (0.1, 0.2, 0.3, 0.4), {"speed", "order"}, {"speed", "order"}),
        ((1.0, 2.0, 2.0, 1.0), (0.1, 0.2, 0.3, 0.4), set(), {"speed", "order"}),
        # a speed that hardly differs is no candidate
        ((1.0, 2.0, 3.0, 4.0), (0.30, 0.301, 0.302, 0.303), {"order"}, {"order"}),
    ],
)  # fmt: skip
def test_what_a_difference_goes_with(value, speed, goes_with, changed) -> None:
    order = Covariate("order", "1", np.arange(1.0, 5.0))
    given = [Covariate("speed", "rad/s", np.array(speed)), order]
    found = explain(np.array(value), np.full(4, 0.01), np.arange(4), given)
    assert set(found.goes_with) == goes_with and found.alone is None
    assert set(found.changed) == changed
    if goes_with == {"speed"}:
        # over the order 1..4 the line 1.3 + 0.8 k leaves 1.8 of 5
        assert found.shares["order"] == pytest.approx(0.64)


@pytest.mark.parametrize(
    ("torque", "problem"),
    [
        ((True,), "one recording agrees with itself"),
        ((True, False), r"only recording_0\.csv has torque"),
        ((False, False), "no recording holds a torque"),
    ],
)
def test_too_few_recordings_to_compare(torque: tuple[bool, ...], problem: str) -> None:
    every = [recorded(Truth(), k) for k in range(len(torque))]
    for k in np.flatnonzero(~np.array(torque)):
        every[k] = replace(every[k], tau=None)
    with pytest.raises(InputError, match=problem):
        compared(every)


def test_no_motion() -> None:
    one = recorded(Truth(), 0)
    still = replace(one, q=np.full_like(one.q, 0.3))
    with pytest.raises(InputError, match="trajectory is constant"):
        compared([still, still])
