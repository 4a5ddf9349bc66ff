"""Localisation in depth: planted regimes are found and told, noise has none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from sweeps import daily

from gapscope.diagnosis.locate import (
    MotionRows,
    Region,
    levels,
    locate,
)

RATE = 250.0
SECONDS = 30.0
FLOOR = 0.05


def motion(seed: int = 0, joints: int = 2, seconds: float = SECONDS) -> MotionRows:
    """Two recordings of sums of sines."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    t = np.arange(n) / RATE
    q = sum(
        rng.uniform(0.2, 0.8, joints)
        * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, joints))
        for f in (0.11, 0.23, 0.37, 0.61)
    )
    dq = np.gradient(q, 1 / RATE, axis=0)
    ddq = np.gradient(dq, 1 / RATE, axis=0)
    half = n // 2
    return MotionRows(
        np.tile(t[:half], 2), q, dq, ddq, np.repeat([0, 1], half), (RATE, RATE)
    )


def load_of(rows: MotionRows) -> np.ndarray:
    return 10 * np.cos(rows.q) + 0.5 * rows.ddq


def filtered(series: np.ndarray) -> np.ndarray:
    return sosfiltfilt(butter(4, 12.0, output="sos", fs=RATE), series, axis=0)


def noise(rows: MotionRows, seed: int) -> np.ndarray:
    white = filtered(np.random.default_rng(seed).standard_normal(rows.q.shape))
    return FLOOR * white / white.std()


def found(rows: MotionRows, error: np.ndarray, kind: str) -> Region | None:
    places = locate(error, rows, load_of(rows), np.full(rows.q.shape[1], FLOOR), [1])
    return next((region for region in places[0].regions if region.kind == kind), None)


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
    seed: int,
    where: Callable[[MotionRows], np.ndarray],
    quantity: str,
    bound: tuple[str, float, float],
) -> None:
    rows = motion(seed)
    region = found(
        rows, noise(rows, seed) + 10 * where(rows) * noise(rows, 50 + seed), "rule"
    )
    assert region is not None and region.share > 0.6 and region.enrichment > 1.6
    [condition] = [c for c in region.detail["conditions"] if c["quantity"] == quantity]
    side, value, margin = bound
    assert condition[side] == pytest.approx(value, abs=margin)
    assert condition["symbol"] in region.regime and condition["unit"] in region.regime


def test_two_conditions_are_joined() -> None:
    rows = motion(1)
    inside = (np.abs(rows.dq) < 0.6) & (rows.dq < 0)
    region = found(rows, noise(rows, 1) + 10 * inside * noise(rows, 2), "rule")
    assert (
        region is not None
        and "moving backward" in region.regime
        and "|dq| <" in region.regime
    )
    assert " and " in region.regime and region.share > 0.6


@pytest.mark.parametrize("seed", daily(range(12), 0, 1))
def test_noise_has_no_rule_no_interval_no_line(seed: int) -> None:
    rows = motion(seed)
    for error in (noise(rows, seed), 5 * noise(rows, 100 + seed)):
        places = locate(error, rows, load_of(rows), np.full(2, FLOOR), [1, 2])
        assert [region for place in places for region in place.regions] == []


@pytest.mark.parametrize("seed", daily(range(4), 0))
def test_an_interval_of_time_starts_and_stops(seed: int) -> None:
    rows = motion(seed)
    pushed = ((rows.segment == 1) & (rows.t >= 3.0) & (rows.t <= 5.0))[:, None]
    region = found(
        rows, noise(rows, seed) + 8 * pushed * noise(rows, 9 + seed), "interval"
    )
    assert region is not None and region.regime.startswith("recording 2, starts at")
    assert region.detail["start"] == pytest.approx(3.0, abs=0.3) and region.detail[
        "end"
    ] == pytest.approx(5.0, abs=0.3)
    assert region.share > 0.7 and region.coverage < 0.1
    rule = found(rows, noise(rows, seed) + 8 * pushed * noise(rows, 9 + seed), "rule")
    assert rule is None or "t " not in rule.regime, (
        "an interval knows the recording, a rule over time does not"
    )


def test_two_contacts_are_two_intervals() -> None:
    rows = motion(3)
    pushed = (
        ((rows.t >= 3.0) & (rows.t <= 4.5)) | ((rows.t >= 9.0) & (rows.t <= 10.0))
    ) & (rows.segment == 0)
    places = locate(
        noise(rows, 3) + pushed[:, None], rows, load_of(rows), np.full(2, FLOOR), [1]
    )
    told = sorted(
        (r.detail["start"], r.detail["end"])
        for r in places[0].regions
        if r.kind == "interval"
    )
    np.testing.assert_allclose(told, [(3.0, 4.5), (9.0, 10.0)], atol=0.3)


@pytest.mark.nightly
def test_a_slow_gap_that_comes_and_goes_seldom_has_a_start() -> None:
    told = 0
    for seed in range(20):
        rows = motion(seed)
        slow = butter(2, (0.1, 1.0), "bandpass", output="sos", fs=RATE)
        white = np.random.default_rng(seed).standard_normal((3 * len(rows.t), 2))
        error = sosfiltfilt(slow, white, axis=0)[
            len(rows.t) : 2 * len(rows.t)
        ]  # without the filter's ends
        [place] = locate(
            10 * FLOOR * error / error.std(),
            rows,
            load_of(rows),
            np.full(2, FLOOR),
            [1],
        )
        told += len(
            {region.kind for region in place.regions} & {"interval", "rule", "line"}
        )
    assert told <= 4


def test_times_are_those_of_the_recording_that_was_cut() -> None:
    rows = motion(0)
    cut = MotionRows(
        rows.t,
        rows.q,
        rows.dq,
        rows.ddq,
        rows.segment,
        rows.rates,
        ("a.csv", "a.csv"),
        (0.3, 15.3),
    )
    late = (cut.clock > 20.0)[:, None]
    region = found(cut, noise(cut, 0) + 8 * late * noise(cut, 1), "interval")
    assert (
        region is not None
        and region.detail["recording"] == "a.csv"
        and region.detail["end"] is None
    )
    assert region.detail["start"] == pytest.approx(20.0, abs=0.3)
    assert len(levels(late[:, 0].astype(float), cut, FLOOR)) == 1


def test_a_line_of_its_own() -> None:
    rows = motion(2)
    hum = 0.3 * np.sin(2 * np.pi * 6.0 * rows.t)[:, None]
    region = found(rows, noise(rows, 2) + hum, "line")
    assert region is not None and region.detail["frequency"] == pytest.approx(
        6.0, abs=0.1
    )
    assert region.regime == "line at 6.0 Hz" and region.share > 0.7
    assert found(rows, noise(rows, 2) + hum, "coherence") is None, (
        "the joint's own signals have nothing there"
    )


@pytest.mark.parametrize(
    ("gap", "signal", "gain", "words"),
    [
        (lambda rows: 0.4 * rows.ddq, "acceleration", 0.4, "in step"),
        (lambda rows: -0.6 * rows.dq, "velocity", 0.6, "sign reversed"),
        (lambda rows: 0.1 * load_of(rows), "torque", 0.1, "in step"),
    ],
)
def test_gain_and_phase_against_the_joints_own_signals(
    gap: Callable[[MotionRows], np.ndarray], signal: str, gain: float, words: str
) -> None:
    rows = motion(3)
    region = found(rows, gap(rows) + 0.2 * noise(rows, 3), "coherence")
    assert (
        region is not None
        and region.detail["signal"] == signal
        and words in region.regime
    )
    assert (
        region.detail["gain"] == pytest.approx(gain, rel=0.1)
        and region.detail["coherence"] > 0.9
    )
