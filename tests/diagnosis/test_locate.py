"""Where a gap lies: planted regimes, times and frequencies are found and told, noise has none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import synthetic
from scipy.signal import butter, sosfiltfilt
from sweeps import daily

from gapscope.diagnosis.locate import MotionRows, Region, locate, regions
from gapscope.diagnosis.thresholds import REGION_ENRICHMENT, REGION_SHARE

RATE, SECONDS, FLOOR = 250.0, 30.0, 0.05
Where = Callable[[MotionRows], np.ndarray]


def motion(seed: int = 0) -> MotionRows:
    """Two recordings of sums of sines of two joints."""
    rng, n = np.random.default_rng(seed), int(SECONDS * RATE)
    t, half, q = np.arange(n) / RATE, n // 2, np.zeros((n, 2))
    for frequency in (0.11, 0.23, 0.37, 0.61):
        size, phase = rng.uniform(0.2, 0.8, 2), rng.uniform(0, 6, 2)
        q += size * np.sin(2 * np.pi * frequency * t[:, None] + phase)
    dq = np.gradient(q, 1 / RATE, axis=0)
    ddq, segment = np.gradient(dq, 1 / RATE, axis=0), np.repeat([0, 1], half)
    return MotionRows(np.tile(t[:half], 2), q, dq, ddq, segment, (RATE, RATE))


def load_of(rows: MotionRows) -> np.ndarray:
    return 10 * np.cos(rows.q) + 0.5 * rows.ddq


def white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((int(SECONDS * RATE), 2))


def noise(seed: int) -> np.ndarray:
    """In the band of the gap, as large as the floor."""
    sos = butter(4, 12.0, output="sos", fs=RATE)
    filtered = sosfiltfilt(sos, white(seed), axis=0)
    return FLOOR * filtered / filtered.std()


def found(rows: MotionRows, error: np.ndarray, kind: str) -> list[Region]:
    """What is learnt of the gap of joint 1."""
    place = locate(error[:, 0], rows, load_of(rows), FLOOR, 1)
    return [region for region in place.regions if region.kind == kind or not kind]


# Parts cut in advance.


def slow(rows: MotionRows) -> np.ndarray:
    return np.abs(rows.dq[:, 0]) <= np.quantile(np.abs(rows.dq[:, 0]), 0.2)


def pushed(rows: MotionRows) -> np.ndarray:
    return (rows.segment == 1) & (rows.t >= 6) & (rows.t <= 9)


def at_one_place(rows: MotionRows) -> np.ndarray:
    edges = np.linspace(rows.q[:, 0].min(), rows.q[:, 0].max(), 6)
    return (rows.q[:, 0] > edges[2]) & (rows.q[:, 0] < edges[3])


@pytest.mark.parametrize(
    ("where", "kind", "regime", "margin"),
    [
        (slow, "regime", "near velocity reversal", 0.01),
        (pushed, "time", "recording 2, 6.0 to 9.0 s", 0.01),
        (at_one_place, "position", "position ", 0.01),
        # the border between directions lies at a higher speed
        (lambda rows: rows.dq[:, 0] > 0.05, "regime", "moving forward", 0.1),
    ],
)
def test_one_part_of_the_motion(
    where: Where, kind: str, regime: str, margin: float
) -> None:
    rows = motion()
    inside = where(rows)
    error = 0.1 * white(2) + inside[:, None] * white(1)
    # white noise is rich in high frequencies wherever it lies
    named = regions(error, rows, load_of(rows), [1], most=5)
    assert "moving backward" not in [region.regime for region in named]
    region = next(r for r in named if r.kind == kind and r.regime.startswith(regime))
    assert region.joint == 1 and region.share > 0.8
    assert region.coverage == pytest.approx(inside.mean(), abs=margin)
    few = regions(error, rows, load_of(rows), [1, 2], most=2)
    assert all(sum(r.joint == joint for r in few) <= 2 for joint in (1, 2))
    for region in few:
        assert REGION_SHARE <= region.share <= 1 and 0 < region.coverage <= 1
        assert region.enrichment >= REGION_ENRICHMENT


@pytest.mark.parametrize(
    ("low", "high"), [(1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 12.0)]
)
def test_one_frequency_band(low: float, high: float) -> None:
    rows, band = motion(), [1.2 * low, 0.9 * high]
    sos = butter(4, band, "bandpass", output="sos", fs=RATE)
    error = sosfiltfilt(sos, white(2), axis=0)
    region = regions(error, rows, load_of(rows), [2])[0]
    assert (region.joint, region.kind) == (2, "frequency")
    assert region.regime == f"{low:g} to {high:g} Hz" and region.share > 0.8


def test_even_gap_has_no_region_in_time_or_regime() -> None:
    rows = motion()
    named = regions(white(6), rows, load_of(rows), [1, 2], most=9)
    assert {region.kind for region in named} <= {"frequency"}
    assert regions(np.zeros_like(rows.q), rows, load_of(rows), [1, 2]) == []


# Rules, intervals, lines and bands that are learnt.


@pytest.mark.parametrize("seed", daily(range(1, 4), 1))
@pytest.mark.parametrize(
    ("where", "quantity", "bound"),
    [
        (lambda rows: np.abs(rows.dq) < 0.1, "speed", ("below", 0.1, 0.05)),
        (lambda rows: rows.q > 0.5, "position", ("above", 0.5, 0.1)),
        (lambda rows: rows.q < -0.3, "position", ("below", -0.3, 0.1)),
        (lambda rows: np.abs(rows.ddq) > 4.0, "acceleration", ("above", 4.0, 0.8)),
    ],
)
def test_a_planted_regime_is_told(
    seed: int, where: Where, quantity: str, bound: tuple[str, float, float]
) -> None:
    rows = motion(seed)
    (region,) = found(rows, noise(seed) + 10 * where(rows) * noise(50 + seed), "rule")
    assert region.share > 0.6 and region.enrichment > 1.6
    [condition] = [c for c in region.detail["conditions"] if c["quantity"] == quantity]
    side, value, margin = bound
    assert condition[side] == pytest.approx(value, abs=margin)
    assert condition["symbol"] in region.regime and condition["unit"] in region.regime


def test_two_conditions_are_joined() -> None:
    rows = motion(1)
    inside = (np.abs(rows.dq) < 0.6) & (rows.dq < 0)
    (region,) = found(rows, noise(1) + 10 * inside * noise(2), "rule")
    assert "moving backward" in region.regime and "|dq| <" in region.regime
    assert " and " in region.regime and region.share > 0.6


@pytest.mark.parametrize("seed", daily(range(12), 0, 1))
def test_noise_has_no_rule_no_interval_no_line(seed: int) -> None:
    rows = motion(seed)
    for error in (noise(seed), 5 * noise(100 + seed)):
        assert found(rows, error, "") == []


@pytest.mark.parametrize("seed", daily(range(4), 0))
def test_an_interval_of_time_starts_and_stops(seed: int) -> None:
    rows = motion(seed)
    inside = ((rows.segment == 1) & (rows.t >= 3.0) & (rows.t <= 5.0))[:, None]
    error = noise(seed) + 8 * inside * noise(9 + seed)
    (region,) = found(rows, error, "interval")
    assert region.regime.startswith("recording 2, starts at")
    assert region.detail["start"] == pytest.approx(3.0, abs=0.3)
    assert region.detail["end"] == pytest.approx(5.0, abs=0.3)
    assert region.share > 0.7 and region.coverage < 0.1
    # an interval knows the recording, a rule over time does not
    assert not any("t " in rule.regime for rule in found(rows, error, "rule"))


def test_two_contacts_are_two_intervals() -> None:
    rows = motion(3)
    first, second = (
        (rows.segment == 0) & (rows.t >= low) & (rows.t <= high)
        for low, high in ((3.0, 4.5), (9.0, 10.0))
    )
    told = found(rows, noise(3) + (first | second)[:, None], "interval")
    ends = sorted((r.detail["start"], r.detail["end"]) for r in told)
    np.testing.assert_allclose(ends, [(3.0, 4.5), (9.0, 10.0)], atol=0.3)


def test_times_are_those_of_the_recording_that_was_cut() -> None:
    rows = motion(0)
    series = rows.t, rows.q, rows.dq, rows.ddq, rows.segment, rows.rates
    cut = MotionRows(*series, ("a.csv", "a.csv"), (0.3, 15.3))
    late = (cut.clock > 20.0)[:, None]
    (region,) = found(cut, noise(0) + 8 * late * noise(1), "interval")
    assert region.detail["recording"] == "a.csv" and region.detail["end"] is None
    assert region.detail["start"] == pytest.approx(20.0, abs=0.3)


def test_a_line_of_its_own() -> None:
    rows = motion(2)
    hum = 0.3 * np.sin(2 * np.pi * 6.0 * rows.t)[:, None]
    (region,) = found(rows, noise(2) + hum, "line")
    assert region.detail["frequency"] == pytest.approx(6.0, abs=0.1)
    assert region.regime == "line at 6.0 Hz" and region.share > 0.7
    # the joint's own signals have nothing there
    assert found(rows, noise(2) + hum, "coherence") == []


@pytest.mark.parametrize(
    ("gap", "signal", "gain", "words"),
    [
        (lambda rows: 0.4 * rows.ddq, "acceleration", 0.4, "in step"),
        (lambda rows: -0.6 * rows.dq, "velocity", 0.6, "sign reversed"),
        (lambda rows: 0.1 * load_of(rows), "torque", 0.1, "in step"),
    ],
)
def test_gain_and_phase_against_the_joints_own_signals(
    gap: Where, signal: str, gain: float, words: str
) -> None:
    rows = motion(3)
    region = found(rows, gap(rows) + 0.2 * noise(3), "coherence")[0]
    assert region.detail["signal"] == signal and words in region.regime
    assert region.detail["gain"] == pytest.approx(gain, rel=0.1)
    assert region.detail["coherence"] > 0.9


def a_cable_at_one_place(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return (np.abs(q) < 0.15) * [0.0, 4.0, 0.0]


def test_a_rule_says_where_a_cable_pulls() -> None:
    truth = synthetic.Truth(extra=a_cable_at_one_place)
    document = synthetic.diagnosed(truth, seed=3).document
    assert document["verdict"] == "unexplained"
    for regions_of in (document["where"], document["unexplained"]["where"]):
        first = regions_of[0]
        assert first["joint"] == 2 and first["share"] > 0.7
        assert first["regime"].startswith("position")
        [rule] = [region for region in regions_of if region["kind"] == "rule"]
        [condition] = rule["conditions"]
        assert condition["quantity"] == "position" and rule["share"] > 0.9
        assert condition["above"] == pytest.approx(-0.15, abs=0.03)
        assert condition["below"] == pytest.approx(0.15, abs=0.03)
