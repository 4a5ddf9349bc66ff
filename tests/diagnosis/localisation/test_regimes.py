"""Where a gap lies: regions of constructed gaps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import synthetic
from scipy.signal import butter, sosfiltfilt

from gapscope.diagnosis.locate import MotionRows, Region, regions
from gapscope.diagnosis.thresholds import REGION_ENRICHMENT, REGION_SHARE

RATE = 250.0
N = 5000


@pytest.fixture
def rows() -> MotionRows:
    """Twenty seconds of two joints in two recordings, speeds that vary."""
    t = np.arange(N) / RATE
    q = np.column_stack([np.sin(2 * t) + 0.4 * np.sin(3.1 * t), np.cos(1.7 * t)])
    dq, step = np.gradient(q, 1 / RATE, axis=0), np.repeat([0, 1], N // 2)
    return MotionRows(
        np.tile(t[: N // 2], 2),
        q,
        dq,
        np.gradient(dq, 1 / RATE, axis=0),
        step,
        (RATE, RATE),
    )


def noise(seed: int = 0) -> np.ndarray:
    return 0.05 * np.random.default_rng(seed).standard_normal((N, 2))


def load(rows: MotionRows) -> np.ndarray:
    """Torque of gravity and friction."""
    return 10 * np.cos(rows.q) + 3 * np.tanh(rows.dq / 0.005)


def strongest(
    error: np.ndarray, rows: MotionRows, joint: int = 1, kind: str = ""
) -> Region:
    """The first region named, or the first of a kind: white noise is rich in high frequencies wherever it lies."""
    found = regions(error, rows, load(rows), [joint], most=5)
    return next(region for region in found if region.kind == kind or not kind)


def slow(rows: MotionRows) -> np.ndarray:
    return np.abs(rows.dq[:, 0]) <= np.quantile(np.abs(rows.dq[:, 0]), 0.2)


def pushed(rows: MotionRows) -> np.ndarray:
    """From 4 to 6 s of the second recording."""
    return (rows.segment == 1) & (rows.t >= 4) & (rows.t <= 6)


def at_one_place(rows: MotionRows) -> np.ndarray:
    edges = np.linspace(rows.q[:, 0].min(), rows.q[:, 0].max(), 6)
    return (rows.q[:, 0] > edges[2]) & (rows.q[:, 0] < edges[3])


@pytest.mark.parametrize(
    ("where", "kind", "regime"),
    [
        (slow, "regime", "near velocity reversal"),
        (pushed, "time", "recording 2, 4.0 to 6.0 s"),
        (at_one_place, "position", "position -0.30 to 0.25 rad"),
    ],
)
def test_one_part_of_the_motion(
    rows: MotionRows, where: Callable[[MotionRows], np.ndarray], kind: str, regime: str
) -> None:
    inside, white = where(rows), np.random.default_rng(1).standard_normal((N, 2))
    region = strongest(noise() + inside[:, None] * white, rows, kind=kind)
    assert region.joint == 1 and region.regime.startswith(regime)
    assert region.share > 0.9
    assert region.coverage == pytest.approx(inside.mean(), abs=0.01)


@pytest.mark.parametrize(
    ("low", "high"), [(1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 12.0)]
)
def test_one_frequency_band(rows: MotionRows, low: float, high: float) -> None:
    band = butter(4, [1.2 * low, 0.9 * high], "bandpass", output="sos", fs=RATE)
    error = sosfiltfilt(band, np.random.default_rng(2).standard_normal((N, 2)), axis=0)
    region = strongest(error, rows, joint=2)
    assert (region.joint, region.kind, region.regime) == (
        2,
        "frequency",
        f"{low:g} to {high:g} Hz",
    )
    assert region.share > 0.8


def test_one_direction_of_motion(rows: MotionRows) -> None:
    white = np.random.default_rng(5).standard_normal((N, 2))
    named = regions(noise() + (rows.dq > 0.05) * white, rows, load(rows), [1], most=5)
    assert "moving forward" in [r.regime for r in named] and "moving backward" not in [
        r.regime for r in named
    ]


def test_even_gap_has_no_region_in_time_or_regime(rows: MotionRows) -> None:
    error = np.random.default_rng(6).standard_normal((N, 2))
    assert [
        r
        for r in regions(error, rows, load(rows), [1, 2], most=9)
        if r.kind != "frequency"
    ] == []


def test_regions_are_large_enriched_and_few(rows: MotionRows) -> None:
    error = noise() + (np.abs(rows.dq) > 1.5) * np.random.default_rng(
        7
    ).standard_normal((N, 2))
    found = regions(error, rows, load(rows), [1, 2], most=2)
    assert found and all(
        r.share >= REGION_SHARE and r.enrichment >= REGION_ENRICHMENT for r in found
    )
    assert all(sum(r.joint == joint for r in found) <= 2 for joint in (1, 2))
    assert all(0 <= r.share <= 1 and 0 < r.coverage <= 1 for r in found)


def test_no_gap_no_region(rows: MotionRows) -> None:
    assert regions(np.zeros((N, 2)), rows, load(rows), [1, 2]) == []


def extra_friction_at_low_speed(
    t: np.ndarray, q: np.ndarray, dq: np.ndarray
) -> np.ndarray:
    return 3.0 * np.exp(-((dq / 0.15) ** 2)) * np.tanh(dq / 0.005) * [0.0, 1.0, 0.0]


def a_cable_at_one_place(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return (np.abs(q) < 0.15) * [0.0, 4.0, 0.0]


@pytest.mark.nightly
def test_the_first_regions_of_a_diagnosis() -> None:
    truth = synthetic.Truth(extra=extra_friction_at_low_speed)
    document = synthetic.diagnosed(truth, seed=3).document
    first = document["where"][0]
    assert (
        first["joint"] == 2
        and first["regime"].startswith("near velocity reversal")
        and first["share"] > 0.7
    )


def test_a_rule_says_where_a_cable_pulls() -> None:
    truth = synthetic.Truth(extra=a_cable_at_one_place)
    document = synthetic.diagnosed(truth, seed=3).document
    assert document["verdict"] == "unexplained"
    for regions_of in (document["where"], document["unexplained"]["where"]):
        first = regions_of[0]
        assert (
            first["joint"] == 2
            and first["regime"].startswith("position")
            and first["share"] > 0.7
        )
        [rule] = [region for region in regions_of if region["kind"] == "rule"]
        [condition] = rule["conditions"]
        assert condition["quantity"] == "position" and rule["share"] > 0.9
        assert condition["above"] == pytest.approx(-0.15, abs=0.03)
        assert condition["below"] == pytest.approx(0.15, abs=0.03)
