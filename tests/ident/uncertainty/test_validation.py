"""Errors of a prediction, and whether what is left is noise."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.motions.motion import Motion
from gapscope.ident.signals.samples import Band
from gapscope.ident.uncertainty.validation import (
    LAGS,
    band_correlation,
    errors,
    validate,
    whiteness,
)
from gapscope.model.conditioning import Segment, low_pass


def test_errors_by_hand() -> None:
    torque = np.array([[3.0, 1.0], [4.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    predicted = torque - [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [-1.0, 2.0]]
    found = errors(torque, predicted, np.full((4, 2), True))
    np.testing.assert_allclose(found.rmse, [1.0, 1.0])
    np.testing.assert_allclose(found.relative, [1 / 2.5, 1.0])
    np.testing.assert_allclose(found.largest, [1.0, 2.0])
    assert found.overall == pytest.approx(np.sqrt(8 / 29))


def test_masked_samples_do_not_count() -> None:
    torque, predicted = (
        np.array([[2.0], [2.0], [2.0]]),
        np.array([[1.0], [2.0], [-90.0]]),
    )
    found = errors(torque, predicted, np.array([[True], [True], [False]]))
    assert found.rmse[0] == pytest.approx(np.sqrt(0.5)) and found.largest[0] == 1.0
    assert found.share[0] == pytest.approx(2 / 3)
    assert np.isnan(errors(torque, predicted, np.zeros((3, 1), dtype=bool)).relative[0])


class TestWhiteness:
    def judged(
        self, residual: np.ndarray, rate: float = 250.0, cutoff: float = 20.0
    ) -> np.ndarray:
        step = round(rate / cutoff)
        left = low_pass(residual, rate, cutoff)[::step]
        return whiteness(
            left, np.zeros(len(left), dtype=int), band_correlation(rate, cutoff, step)
        ).p_value

    def test_noise_in_the_band_passes(self) -> None:
        p_values = self.judged(np.random.default_rng(0).standard_normal((20_000, 40)))
        assert (p_values > 0.001).mean() > 0.95 and (
            p_values < 0.5
        ).mean() == pytest.approx(0.5, abs=0.2)

    def test_what_follows_the_motion_does_not(self) -> None:
        rng = np.random.default_rng(1)
        slow = 0.5 * np.sin(2 * np.pi * 0.4 * np.arange(5000) / 250)[:, None]
        assert self.judged(slow + rng.standard_normal((5000, 1)))[0] < 1e-3

    def test_correlation_of_the_band_is_that_of_filtered_noise(self) -> None:
        noise = low_pass(np.random.default_rng(2).standard_normal(400_000), 250.0, 20.0)
        expected = band_correlation(250.0, 20.0, 3)
        found = [
            np.mean(noise[: len(noise) - 3 * k] * noise[3 * k :])
            for k in range(LAGS + 1)
        ]
        np.testing.assert_allclose(found / found[0], expected, atol=0.03)


def test_same_filter_on_both_sides() -> None:
    """A model that is right up to what the filter takes away leaves nothing."""
    t = np.arange(1000) / 250
    torque = (
        np.sin(2 * np.pi * 3 * t)[:, None] + np.sign(np.sin(2 * np.pi * t))[:, None]
    )
    motion = Motion(t, t[:, None], np.ones((1000, 1)), np.zeros((1000, 1)))
    segment = Segment("made.csv", motion, torque)
    found = validate(
        "judge", [segment, segment], Band(5.0), lambda m: torque, lambda m: 0.9 * torque
    )
    assert found.every.overall < 1e-12 and found.nominal.overall == pytest.approx(0.1)
    assert found.recordings == ("made.csv",) and len(found.edges) == 3
    assert len(found.t) == 2 * (1000 - 2 * 75)
