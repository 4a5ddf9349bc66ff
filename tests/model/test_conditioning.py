"""Signal conditioning: what passes, what is cut, and that nothing is invented between the samples."""

from __future__ import annotations

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.model.conditioning import (
    TRIM,
    blocks,
    condition,
    jumps,
    low_pass,
    pieces,
    position_cutoff,
    position_cutoffs,
    slips,
    uniform,
    without_slips,
)
from gapscope.model.effective_samples import (
    autocovariance,
    low_pass_inflation,
    variance_inflation,
)


def sine(
    frequency: float = 1.0,
    *,
    rate: float = 250.0,
    duration: float = 6.0,
    start: float = 0.0,
    torque: bool = True,
) -> Recording:
    """Two joints a quarter period apart, and a torque in phase with the first."""
    t = np.arange(round(duration * rate) + 1) / rate
    phase = 2 * np.pi * frequency * t
    q = np.column_stack([np.sin(phase), np.cos(phase)])
    return Recording("sine.csv", start + t, q, 3 * q if torque else None)


@pytest.mark.parametrize("frequency", [0.5, 3.0, 12.0, 20.0])
def test_sine_keeps_its_phase_and_shrinks_as_the_formula_says(frequency: float) -> None:
    """Forward and backward: |H|^2 = 1 / (1 + (tan(pi f / fs) / tan(pi fc / fs))^8), no phase."""
    wave = np.sin(2 * np.pi * frequency * np.arange(2500) / 250)
    out = low_pass(wave[:, None], 250.0, 12.0)
    ratio = np.tan(np.pi * frequency / 250) / np.tan(np.pi * 12.0 / 250)
    inner = slice(250, -250)
    assert out[inner, 0] == pytest.approx(wave[inner] / (1 + ratio**8), abs=2e-3)


def test_a_series_may_be_shorter_than_its_padding() -> None:
    assert np.isfinite(low_pass(np.ones((5, 2)), 250.0, 5.0)).all()


def jittered() -> Recording:
    """Time stamps that scatter by a third of a step."""
    whole = sine()
    shift = np.random.default_rng(3).uniform(-0.3, 0.3, len(whole.t)) / 250
    phase = 2 * np.pi * (whole.t + shift)[:, None] + [0.0, np.pi / 2]
    return Recording("j.csv", whole.t + shift, np.sin(phase), 3 * np.sin(phase))


def gaps(*between: tuple[float, float]) -> Recording:
    """Eight seconds without the rows between moments [s]."""
    whole = sine(duration=8.0)
    gone = [(whole.t > start) & (whole.t < end) for start, end in between]
    return whole.part(~np.any(gone, axis=0))


LOGS = {
    "even": (sine(), 1, 250.0, 1.0),
    "a lost row in 200": (sine().part(np.arange(1501) % 200 != 100), 1, 250.0, 9.0),
    "jitter": (jittered(), 1, 250.0, 9.0),
    "a gap is cut": (gaps((3.0, 3.5)), 2, 250.0, 2.0),
    "a short stretch is left out": (gaps((3.0, 3.5), (4.2, 5.0)), 2, 250.0, 2.0),
    "slow": (sine(rate=60.0), 1, 60.0, 9.0),
    "not quite twice": (sine(rate=499.0), 1, 499.0, 1.0),
    "every second row": (sine(rate=600.0), 1, 300.0, 1.0),
    "every fourth row": (sine(rate=1000.0), 1, 250.0, 1.0),
    "every twentieth row": (sine(rate=5000.0), 1, 250.0, 1.0),
}
"""A log of sines of 1 Hz, its stretches, the rate to work at [Hz], and how much less exact it is."""


@pytest.mark.parametrize("log", LOGS)
def test_stretches_hold_the_motion_and_the_torque(log: str) -> None:
    """Evenly sampled on one clock, trimmed, with derivatives; nothing is invented between them."""
    recording, stretches, rate, loose = LOGS[log]
    found = condition(recording, 20.0)
    assert len(found) == stretches
    for segment in found:
        motion, inner = segment.motion, segment.inner
        t, w = motion.t[inner], 2 * np.pi
        assert motion.rate == pytest.approx(rate, rel=1e-2)
        assert np.ptp(np.diff(motion.t)) < 1e-9
        assert np.abs(recording.t[:, None] - motion.t).min(axis=0).max() < 1.1 / rate
        assert t[0] - motion.t[0] == pytest.approx(TRIM, abs=0.6 / rate)
        assert motion.t[-1] - t[-1] == pytest.approx(TRIM, abs=0.6 / rate)
        phase = w * t[:, None] + [0.0, np.pi / 2]
        assert motion.q[inner] == pytest.approx(np.sin(phase), abs=2e-4 * loose)
        assert motion.dq[inner] == pytest.approx(w * np.cos(phase), abs=2e-3 * loose)
        bend = -(w**2) * np.sin(phase)
        assert motion.ddq[inner] == pytest.approx(bend, abs=0.05 * loose)
        torque = 3 * np.sin(phase)
        assert segment.torque[inner] == pytest.approx(torque, abs=1e-3 * loose)


def test_torque_stays_unfiltered_at_the_working_rate() -> None:
    recording = sine(40.0)
    (segment,) = condition(recording, 10.0)
    np.testing.assert_array_equal(segment.torque, recording.tau)
    np.testing.assert_array_equal(segment.motion.t, recording.t)


def test_stamps_next_to_each_other_have_no_slope_between_them() -> None:
    whole = sine()
    t = np.insert(whole.t, 1, 1e-320)
    q = np.insert(whole.q, 1, whole.q[1], axis=0)
    grid, resampled = uniform(t, q, whole.rate)
    assert resampled == pytest.approx(whole.q[: len(grid)], abs=1e-6)


@pytest.mark.parametrize("rate", [1000.0, 5000.0])
def test_fast_log_is_decimated_and_keeps_the_torque_band(rate: float) -> None:
    """Sines of up to 12 Hz stay, and what lies far above the new Nyquist does not fold into the band."""
    t = np.arange(round(6 * rate)) / rate
    q = np.column_stack([np.sin(t), np.cos(t)])
    for frequency, expected in ((2.0, 1.0), (12.0, 1.0), (0.4 * rate + 3.0, 0.0)):
        tau = np.sin(2 * np.pi * frequency * t)
        (made,) = condition(Recording("fast.csv", t, q, tau[:, None] * [1, 1]), 20.0)
        torque, time = made.torque[made.inner, 0], made.motion.t[made.inner]
        assert len(time) < len(t) / 2
        wave = expected * np.sin(2 * np.pi * frequency * time)
        assert torque == pytest.approx(wave, abs=1e-3)


def test_without_torque_but_with_sensor() -> None:
    bare = sine(torque=False)
    sensor = Recording("s.csv", bare.t, bare.q, tau_sensor=2 * bare.q)
    for recording in (bare, sensor):
        (segment,) = condition(recording, 10.0)
        assert segment.torque is None
        np.testing.assert_array_equal(segment.torque_sensor, recording.tau_sensor)


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (sine(duration=0.8), r"sine\.csv: lasts 0\.8 s, at least 1 s is needed"),
        (gaps(*((k - 0.2, float(k)) for k in range(1, 9))), "no stretch without a gap"),
    ],
)
def test_what_is_too_short_is_an_input_error(recording: Recording, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        condition(recording, 10.0)
    assert caught.value.exit_code == 2 and caught.value.remedy


# The cut-off of positions, chosen by the recordings.


def noisy(noise: float, seed: int = 0) -> Recording:
    t = np.arange(2500) / 250
    motion = sum(np.sin(2 * np.pi * f * t + f) / f for f in (0.3, 0.9, 2.5))
    q = motion[:, None] * [1.0, 0.5]
    rng = np.random.default_rng(seed)
    return Recording("n.csv", t, q + noise * rng.standard_normal(q.shape))


def test_the_noisier_the_lower() -> None:
    cutoffs = [position_cutoff((noisy(noise),)) for noise in (1e-7, 1e-4, 3e-2)]
    assert cutoffs[0] > cutoffs[1] >= cutoffs[2]


@pytest.mark.parametrize("seed", daily(range(5), 0))
def test_accelerations_are_about_as_good_as_any_cutoff_makes_them(seed: int) -> None:
    recording, clean = noisy(1e-3, seed), noisy(0.0, seed)
    true = condition(clean, 40.0)[0]

    def error(cutoff: float | None) -> float:
        found = condition(recording, cutoff)[0]
        off = found.motion.ddq[found.inner] - true.motion.ddq[true.inner]
        return float(np.sqrt((off**2).mean()))

    assert error(None) < 1.5 * min(error(c) for c in np.geomspace(5.0, 40.0, 12))


STILL = 1e-3 * np.random.default_rng(0).standard_normal((2500, 2))
CHIRP = np.sin(2 * np.pi * 3 * (np.arange(2500) / 250) ** 2)[:, None]
BOUNDS = {
    "noise alone": (250.0, STILL, 5.0, 39.99),
    "a chirp": (250.0, CHIRP + 1e-6 * STILL, 40.0, 40.0),
    "perfectly still": (250.0, np.ones((1000, 2)), 5.0, 40.0),
    "below Nyquist": (20.0, sine(1.0, rate=20.0).q, 0.1, 8.0 + 1e-9),
    # as of a time in milliseconds that is read in seconds
    "next to no rate": (0.25, np.sin(np.arange(0.0, 40.0, 0.04))[:, None], 1e-9, 0.1),
}


@pytest.mark.parametrize("log", BOUNDS)
def test_the_cutoff_has_bounds(log: str) -> None:
    rate, q, low, high = BOUNDS[log]
    recording = Recording("r.csv", np.arange(len(q)) / rate, q)
    assert low <= position_cutoff((recording,)) <= high


def test_each_joint_has_its_own_and_the_fastest_recording_counts() -> None:
    fast, slow = sine(6.0, duration=10.0), sine(0.5, duration=10.0)
    noise = np.random.default_rng(1).standard_normal(fast.q.shape)
    q = np.column_stack([fast.q[:, 0], slow.q[:, 0]]) + 1e-4 * noise
    first, second = position_cutoffs(Recording("two.csv", fast.t, q))
    assert first > 1.5 * second
    slow, fast = noisy(1e-3), Recording("fast.csv", fast.t, fast.q + 1e-3 * noise)
    both = position_cutoff((slow, fast))
    assert both == position_cutoff((fast,)) > position_cutoff((slow,))


@pytest.mark.parametrize(
    ("count", "rate", "start"),
    [(2, 125.0, 0.0), (4, 30.0, 0.0), (7, 250.0, 12.345), (4, 250.0, 1.7e9)],
)
def test_blocks_are_disjoint_and_hold_the_samples_of_the_segment(
    count: int, rate: float, start: float
) -> None:
    """Whatever the rounding of time."""
    (segment,) = condition(sine(rate=rate, duration=12.0, start=start), 8.0)
    parts = blocks(segment, count)
    assert len(parts) == count
    times = np.concatenate([b.motion.t[b.inner] for b in parts])
    np.testing.assert_array_equal(times, segment.motion.t[segment.inner])
    assert np.ptp([len(b.motion.t) for b in parts]) <= 1
    for block in parts:
        rows = np.searchsorted(segment.motion.t, block.motion.t)
        for name in ("q", "dq", "ddq"):
            expected = getattr(segment.motion, name)[rows]
            np.testing.assert_array_equal(getattr(block.motion, name), expected)
        np.testing.assert_array_equal(block.torque, segment.torque[rows])
        assert block.recording == segment.recording


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_a_reading_that_jumps_ends_a_piece(rate: float) -> None:
    whole = sine(rate=rate)
    slipped = whole.q.copy()
    k = round(0.4 * len(whole.t))
    slipped[k:, 1] += 0.1
    found = Recording("slip.csv", whole.t, slipped, whole.tau)
    assert jumps(whole) == [] and [jump.sample for jump in jumps(found)] == [k]
    assert pieces(found) == [slice(0, k), slice(k, len(whole.t))]
    # what a joint has of its own in either piece does not reach the other
    for segment in condition(found, 20.0):
        assert np.abs(segment.motion.dq[segment.inner]).max() < 7.0
    assert position_cutoff((found,)) <= position_cutoff((whole,))


def test_a_row_that_is_repeated_or_lost_or_a_pause_or_noise_is_no_jump() -> None:
    whole = sine()
    rows = np.arange(len(whole.t))
    repeated = Recording("r.csv", whole.t, whole.q[np.where(rows == 700, 699, rows)])
    lost = whole.part(rows != 700)
    paused = whole.part((rows < 700) | (rows > 900))
    rng = np.random.default_rng(1)
    noisy = Recording("n.csv", whole.t, whole.q + 1e-3 * rng.normal(size=whole.q.shape))
    coarse = Recording("c.csv", whole.t, np.round(whole.q, 2))
    for recording in (repeated, lost, paused, noisy, coarse):
        assert jumps(recording) == []


def test_a_slip_is_a_jump_of_one_reading_that_no_lost_rows_explain() -> None:
    whole = sine()
    k = 700
    slipped = whole.q.copy()
    slipped[k:, 1] -= 0.05
    found = Recording("slip.csv", whole.t, slipped, whole.tau)
    (slip,) = slips(found)
    assert (slip.sample, slip.joint) == (k, 1)
    assert slip.size == pytest.approx(-0.05, abs=max(slip.error, 1e-3))
    assert np.abs(without_slips(found).q - whole.q).max() < 1e-3
    assert without_slips(whole) is whole
    # rows that are lost without a trace in the stamps move both joints on
    gone = np.delete(np.arange(len(whole.t)), slice(k, k + 20))
    cut = Recording("cut.csv", whole.t[: len(gone)], whole.q[gone])
    assert jumps(cut) and not slips(cut)
    # as they do if one of them stands still
    still = cut.q * [1.0, 0.0]
    assert not slips(Recording("still.csv", cut.t, still))


# Each way to count independent samples, against values worked out by hand or against drawn series.


INTERVAL = 0.02


def test_autocovariance_by_hand_and_within_groups() -> None:
    """1, 2 | 3, 4: lag 0 is 30 / 4; lag 1 only within groups, (1 * 2 + 3 * 4) / 4."""
    series, groups = np.arange(1.0, 5.0)[:, None], np.array([0, 0, 1, 1])
    assert autocovariance(series, groups, 1)[:, 0] == pytest.approx([7.5, 3.5])


def test_inflation_of_a_first_order_process() -> None:
    """AR(1) with 0.8: (1 + 0.8) / (1 - 0.8) = 9."""
    rng = np.random.default_rng(0)
    series = rng.standard_normal((20000, 3))
    for i in range(1, len(series)):
        series[i] += 0.8 * series[i - 1]
    found = variance_inflation(series, np.zeros(len(series), int))
    assert np.allclose(found, 9.0, rtol=0.25)


def test_inflation_of_a_low_pass() -> None:
    """Of a long series of filtered noise; at Nyquist's frequency nothing was filtered."""
    white = np.random.default_rng(0).standard_normal((50000, 4))
    series = low_pass(white, 1 / INTERVAL, 5.0)
    blocks = series.reshape(100, 500, 4).mean(axis=1)
    expected = 500 * blocks.var() / series.var()
    assert low_pass_inflation(5.0, INTERVAL) == pytest.approx(expected, rel=0.15)
    assert low_pass_inflation(25.0, INTERVAL) == 1.0
