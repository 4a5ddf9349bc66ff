"""Recordings that no arm can have made: each is refused, or diagnosed with a word, for the right reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from cases import case_of, to_and_fro
from synthetic import Truth

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.plausible_data import (
    check_moving,
    check_rates,
    check_torque,
    select_windows,
    short_note,
    still_note,
)
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.diagnosis.setup_faults.clocks import find_stamps
from gapscope.diagnosis.thresholds import EXAMINED, MIN_WINDOW, WINDOW
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import iiwa
from gapscope.model.conditioning import low_pass, pieces

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


ALONE, UNCHANGED = "the arm stands still", "the positions never change, but the torque"


@pytest.mark.parametrize(
    ("recordings", "message"),
    [
        ([recording(q=STILL)], f"a.csv, columns q: {ALONE}"),
        ([recording(), recording("b.csv", q=STILL)], f"b.csv, columns q: {UNCHANGED}"),
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
    with pytest.raises(GapscopeError, match="the rate is 5 Hz, expected 8 to 20000"):
        check_rates(case_of("case", ARM, recording(t=0.2 * np.arange(600))))


@pytest.mark.parametrize("last", [1e12, 1e19])
def test_a_stamp_that_leaps_does_not_ask_for_memory(
    last: float, tmp_path: Path
) -> None:
    path, made = tmp_path / "a.npz", recording(t=np.r_[T[:-1], last])
    np.savez(path, t=made.t, q=made.q, tau=made.tau)
    with pytest.raises(GapscopeError, match="row 600, column t: time leaps from 5.98"):
        load_recording(path, ARM, any_unit=True)


# Long recordings are looked at in windows of equal length, spread evenly; short ones as they are.


RATE = 50.0


def lasting(seconds: float, name: str = "long.csv") -> Recording:
    t = np.arange(int(seconds * RATE)) / RATE
    angle = 0.7 * t[:, None] + np.arange(7)
    return Recording(name, t, np.sin(angle), np.cos(angle))


def test_a_minute_is_looked_at_as_it_is() -> None:
    whole = case_of("long", iiwa(), lasting(60.0))
    assert select_windows(whole) is whole


def test_an_hour_is_looked_at_in_every_part() -> None:
    whole = lasting(3600.0)
    seen = select_windows(case_of("long", iiwa(), whole)).recordings[0]
    windows = pieces(seen)
    lengths = [seen.t[w][-1] - seen.t[w][0] for w in windows]
    np.testing.assert_allclose(lengths, WINDOW, atol=0.1)
    assert len(seen.t) / RATE == pytest.approx(EXAMINED, rel=0.01)
    # as long between one and the next, and half as long before the first
    starts = np.array([seen.t[w.start] for w in windows])
    np.testing.assert_allclose(np.diff(starts), 3600.0 / len(windows), rtol=0.01)
    assert starts[0] < 3600.0 / len(windows)
    assert starts[-1] > 3600.0 * (1 - 1 / len(windows))
    # the rows are those of the log
    places = np.searchsorted(whole.t, seen.t)
    np.testing.assert_array_equal(whole.q[places], seen.q)
    assert "windows" in seen.notes[-1]


@pytest.mark.parametrize(("count", "seconds"), [(20, 20.0), (100, 10.0)])
def test_of_many_recordings_each_has_its_window_or_some_from_first_to_last(
    count: int, seconds: float
) -> None:
    made = [lasting(seconds, f"{k}.csv") for k in range(count)]
    seen = select_windows(case_of("long", iiwa(), *made)).recordings
    assert len(seen) == min(count, EXAMINED / MIN_WINDOW)
    assert (seen[0].name, seen[-1].name) == ("0.csv", f"{count - 1}.csv")
    assert sum(len(r.t) for r in seen) / RATE == pytest.approx(EXAMINED, rel=0.05)


# The torque predicted at every sample: finite for each row, of t and q alone, and the same that the gap uses.


COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [2.0]})
DELAY = AppliedEffect("actuator_delay", (1, 3), {"delay": [0.01, 0.02]})
PAYLOAD = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.2, 0.0, 0.0]})


def corrected(*effects: AppliedEffect) -> CorrectedArm:
    return CorrectedArm(synthetic.arm(), effects)


def recorded(truth: Truth = Truth(), rate: float = 250.0) -> Recording:  # noqa: B008
    return synthetic.recordings(truth, 4, duration=6.0, rate=rate)[1]


def only(r: Recording, keep: np.ndarray | slice | None = None) -> Recording:
    """Some rows of a recording, t and q alone."""
    rows = slice(None) if keep is None else keep
    return Recording(r.name, r.t[rows], r.q[rows])


def standing(q: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(q)
    return synthetic.body().inverse_dynamics(q, zero, zero)


def rms(error: np.ndarray, rate: float, cutoff: float = 12.0) -> np.ndarray:
    """Of what passes a low-pass, of each joint, without 0.3 s at both ends."""
    edge = round(0.3 * rate)
    inner = low_pass(error, rate, cutoff)[edge:-edge]
    return np.sqrt((inner**2).mean(axis=0))


@pytest.mark.parametrize("rate", [30.0, 250.0, 1000.0])
def test_one_finite_row_per_sample_near_the_recorded_torque(rate: float) -> None:
    truth = Truth(coulomb=(0.0, 2.0, 0.0), delay=(0.01, 0.0, 0.02))
    r = recorded(truth, rate)
    predicted = predict_torque(corrected(COULOMB, DELAY), only(r))
    assert predicted.shape == (len(r.t), 3) and np.isfinite(predicted).all()
    assert (rms(r.tau - predicted, rate, 5.0) < 0.06 * np.std(r.tau, axis=0)).all()


def test_of_the_recording_only_t_and_q_are_used() -> None:
    r, arm = recorded(), corrected(COULOMB, DELAY)
    reference = predict_torque(arm, only(r))
    rng = np.random.default_rng(0)
    others = ("tau", "dq", "q_ref", "dq_ref", "tau_sensor")
    noisy = {name: rng.standard_normal(r.q.shape) for name in others}
    for same in (replace(r, **noisy), r):
        np.testing.assert_array_equal(predict_torque(arm, same), reference)
    moved = predict_torque(arm, Recording(r.name, r.t, r.q + 0.1))
    assert np.abs(moved - reference).max() > 0.1


@pytest.mark.parametrize(
    ("rate", "jitter", "close"), [(500.0, 0.0, 0.02), (250.0, 0.3, 0.08)]
)
def test_agrees_on_a_fast_log_and_on_jittered_stamps(
    rate: float, jitter: float, close: float
) -> None:
    motion, rng = synthetic.motion(41, 0.2, 6.0), np.random.default_rng(1)
    even = np.arange(round(6.0 * rate) + 1) / rate
    t = even + rng.uniform(-jitter, jitter, len(even)) / rate
    predicted = predict_torque(corrected(), Recording("r", t, motion.position(t)))
    expected = synthetic.needed(Truth(), motion, t)
    assert np.isfinite(predicted).all()
    assert (rms(predicted - expected, rate) < close * expected.std(axis=0)).all()


def test_on_both_sides_of_a_gap() -> None:
    r, arm = recorded(), corrected(COULOMB, DELAY)
    keep = (r.t < 2.5) | (r.t > 3.2)
    torn, whole = predict_torque(arm, only(r, keep)), predict_torque(arm, only(r))
    assert torn.shape == (keep.sum(), 3) and np.isfinite(torn).all()
    t = r.t[keep]
    far = ((t > 0.5) & (t < 2.0)) | ((t > 3.7) & (t < 5.5))
    difference = low_pass(torn - whole[keep], 250.0, 12.0)[far]
    assert np.sqrt((difference**2).mean(axis=0)).max() < 0.5


def test_short_pieces_are_taken_to_stand_still() -> None:
    r = recorded()
    keep = (r.t < 3.0) | ((r.t > 3.5) & (r.t < 3.6)) | (r.t > 4.0)
    predicted = predict_torque(corrected(), only(r, keep))
    short = (r.t[keep] > 3.5) & (r.t[keep] < 3.6)
    expected = standing(r.q[keep][short])
    np.testing.assert_allclose(predicted[short], expected, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 2, 7, 100])
def test_recording_too_short_to_differentiate(rows: int) -> None:
    arm = corrected(COULOMB, DELAY, PAYLOAD)
    predicted = predict_torque(arm, only(recorded(), slice(0, rows)))
    assert predicted.shape == (rows, 3) and np.isfinite(predicted).all()
