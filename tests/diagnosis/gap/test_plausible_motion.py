"""Recordings that no arm can have made: each is refused, or diagnosed with a word, for the right reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import case_of, to_and_fro

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.plausible_data import check_rates, check_torque
from gapscope.diagnosis.gap.plausible_motion import check_moving, short_note, still_note
from gapscope.diagnosis.setup_faults.time_stamps import find_stamps

ARM = NominalArm("two", Path("robot.urdf"), ("shoulder", "elbow"))
T = np.arange(600) / 100


def recording(name: str = "a.csv", **changed: np.ndarray) -> Recording:
    q, _ = to_and_fro(T)
    return replace(Recording(name, T, q, 10 * q), **changed)


def with_cell(channel: str, value: float) -> Recording:
    series = getattr(recording(), channel).copy()
    series[100, 1] = value
    return recording(**{channel: series})


STILL = np.tile([0.3, -0.2], (600, 1))


@pytest.mark.parametrize(
    ("recordings", "message"),
    [
        ([recording(q=STILL)], "a.csv, columns q: the positions never change: without"),
        (
            [recording(), recording("b.csv", q=STILL)],
            "b.csv, columns q: the positions never change, but the torque does",
        ),
        ([with_cell("q", 300.0)], "row 101, column q2: 300 lies alone"),
        ([with_cell("q", -1e12)], "row 101, column q2: -1e.12 rad is beyond"),
        ([with_cell("tau", 1e30)], "row 101, column tau2: 1e.30 N m is beyond"),
        (
            [recording(tau=STILL), recording("b.csv", tau=2 * STILL)],
            r"the torque of no joint changes \(a.csv, b.csv\)",
        ),
    ],
)
def test_refused(recordings: list[Recording], message: str) -> None:
    with pytest.raises(GapscopeError, match=message):
        check_torque(case_of("case", ARM, *recordings))
        check_moving(case_of("case", ARM, *recordings))


def test_what_is_unusual_only_passes() -> None:
    rng = np.random.default_rng(0)
    short = np.where((T > 3.0) & (T < 3.3), 1.0, 0.0)
    brief = np.column_stack([np.sin(T), short + 1e-4 * rng.normal(size=len(T))])
    impact = recording().tau + np.where(T == 2.0, 1e5, 0.0)[:, None]
    resting = recording("b.csv", q=STILL, tau=STILL + 0.01 * rng.normal(size=(600, 2)))
    found = case_of("case", ARM, recording(q=brief), recording(tau=impact), resting)
    check_torque(found)
    check_moving(found)
    assert still_note(found) == ()


def test_a_joint_that_never_moves_is_said() -> None:
    q = recording().q.copy()
    q[:, 1] = 0.4
    found = case_of("case", ARM, recording(q=q), recording(q=q))
    check_moving(found)
    (note,) = still_note(found)
    assert note.startswith("joint 2 (elbow) never moves")
    assert "the other joints are diagnosed" in note


def test_little_motion_is_said() -> None:
    resting = recording(q=STILL)
    moving = recording().duration
    (note,) = short_note(case_of("case", ARM, recording(), recording(), resting))
    seconds = float(note.removeprefix("only ").split()[0])
    assert seconds == pytest.approx(2 * moving, rel=0.1)
    enough = [recording()] * int(np.ceil(22.0 / moving))
    assert short_note(case_of("case", ARM, *enough)) == ()


@pytest.mark.parametrize(
    ("period", "is_ms"), [(0.1, False), (0.2, False), (4.0, True), (0.1002, False)]
)
def test_a_slow_log_is_not_taken_for_one_in_milliseconds(
    period: float, is_ms: bool
) -> None:
    found = find_stamps([recording(t=period * np.arange(600))])
    assert [fault.variant for fault in found] == (["milliseconds"] if is_ms else [])


def test_a_rate_below_any_log_is_named_as_it_is() -> None:
    with pytest.raises(GapscopeError, match="the rate is 5 Hz, expected 10 to 20000"):
        check_rates(case_of("case", ARM, recording(t=0.2 * np.arange(600))))


def leap(t: np.ndarray) -> np.ndarray:
    return np.r_[t[:-1], 1e12]


@pytest.mark.parametrize("change", [leap, lambda t: np.r_[t[:-1], 1e19]])
def test_a_stamp_that_leaps_does_not_ask_for_memory(
    change: Callable[[np.ndarray], np.ndarray], tmp_path: Path
) -> None:
    path = tmp_path / "a.npz"
    made = recording(t=change(T))
    np.savez(path, t=made.t, q=made.q, tau=made.tau)
    with pytest.raises(GapscopeError, match="row 600, column t: time leaps from 5.98"):
        load_recording(path, ARM, any_unit=True)
