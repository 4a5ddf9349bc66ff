"""Recordings: their rate, files of one log, torques that were not measured, and the steps in which others were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.arm.io.load_recording import joined_in_time
from gapscope.arm.recording import (
    Recording,
    held_notes,
    held_torque,
    step_notes,
    torque_step,
)
from gapscope.envs.mystery_arm import iiwa


@pytest.mark.parametrize(
    ("steps", "rate"),
    # of steps of two kinds, as many of each, the median lies between them, far from both
    [([0.004] * 20 + [0.5], 250.0), ([0.02, 0.02, 0.5, 0.5], 1 / 0.26)],
)
def test_rate_is_that_of_the_usual_steps(steps: list[float], rate: float) -> None:
    t = np.cumsum([0.0, *steps])
    recording = Recording("a.csv", t, np.zeros((len(t), 1)))
    assert recording.rate == pytest.approx(rate, rel=0.01)


def test_a_case_notes_what_was_noticed_of_its_recordings_and_a_low_rate() -> None:
    def at(rate: float, *notes: str) -> Recording:
        t = np.arange(50) / rate
        return Recording(f"{rate:g}.csv", t, np.zeros((50, 1)), notes=notes)

    case = Case("lab", Path(), iiwa(), (at(100.0, "one"),), (at(10.0, "two"),))
    assert case.notes == [
        "100.csv: one",
        "10.csv: two",
        "10.csv: delays, elasticity and ripple are hardly seen at 10 Hz; log at 100 Hz or more",
    ]


def log(begun: float, rows: int = 100) -> Recording:
    return Recording("log", np.arange(rows) / 100, np.zeros((rows, 1)), begun=begun)


FILES = {
    "one log": ([(1.0, 100), (0.0, 100), (2.0, 100)], [1.0, 0.0, 2.0]),
    "one log with dates": ([(1.79e9 + 1.0, 100), (1.79e9, 100)], [1.0, 0.0]),
    # both clocks begin at zero, as those of many loggers do
    "split alike": ([(0.0, 100), (1.0, 50), (0.0, 120), (1.2, 50)], [0.0, 1.0, 0.0, 1.2]),
    "at once": ([(0.0, 100), (0.0, 100)], [0.0, 0.0]),
    "a minute later": ([(0.0, 100), (60.0, 100)], [0.0, 0.0]),
    "before the other ended": ([(0.0, 100), (0.5, 100)], [0.0, 0.0]),
}  # fmt: skip
"""Begin and rows of files of logs, and where their time begins."""


@pytest.mark.parametrize("name", FILES)
def test_time_goes_on_over_the_files_of_one_log_alone(name: str) -> None:
    parts, times = FILES[name]
    files = [log(begun, rows) for begun, rows in parts]
    joined = joined_in_time(files)
    assert [one.t[0] for one in joined] == pytest.approx(times, abs=1e-6)
    for before, after in zip(files, joined, strict=True):
        np.testing.assert_allclose(before.stamps, after.stamps, rtol=0, atol=1e-6)


T = np.arange(3000) / 500
RNG = np.random.default_rng(0)
Q = np.column_stack([np.sin(2 * T), np.cos(3 * T)])
TAU = 20 * Q + 0.1 * RNG.standard_normal(Q.shape)
SOUND = Recording("a.csv", T, Q, tau=TAU)


def test_a_limit_that_was_reached_is_no_stuck_sensor() -> None:
    tau = np.column_stack([np.clip(TAU[:, 0], -15, 15), TAU[:, 1]])
    held = held_torque(T, Q, tau)
    assert (held.clipped[:, 0] == (np.abs(TAU[:, 0]) >= 15)).all()
    assert not held.clipped[:, 1].any() and not held.stuck.any()
    (note,) = held_notes(replace(SOUND, tau=tau))
    assert "stands at a limit" in note
    assert note.endswith(f"tau1 {held.clipped[:, 0].mean():.1%}")
    # nor is a command at rest
    still = Q * ((T > 2) & (T < 4))[:, None]
    assert not held_torque(T, still, 20 * still).unknown.any()


def test_a_stuck_sensor() -> None:
    tau = TAU.copy()
    tau[1000:1300, 1] = tau[1000, 1]
    held = held_torque(T, Q, tau)
    assert np.flatnonzero(held.stuck[:, 1]).tolist() == list(range(1001, 1300))
    assert not held.clipped.any() and not held.stuck[:, 0].any()
    (note,) = held_notes(replace(SOUND, tau=tau))
    assert note.endswith("as of a stuck sensor: tau2 10.0%")


@pytest.mark.parametrize("step", [0.5, 2.0])
def test_coarse_steps_are_no_stuck_sensor(step: float) -> None:
    tau = step * np.round(TAU / step)
    assert not held_torque(T, Q, tau).unknown.any()
    np.testing.assert_allclose(torque_step(tau), step)
    assert torque_step(TAU).tolist() == [0.0, 0.0]


def test_steps_are_said_if_their_rounding_is_one_per_cent_of_the_torque() -> None:
    fine, coarse = (replace(SOUND, tau=s * np.round(TAU / s)) for s in (0.1, 1.0))
    assert step_notes(fine) == () and step_notes(SOUND) == ()
    (note,) = step_notes(coarse)
    assert note.endswith("raise the noise floor: tau1 1, tau2 1")
