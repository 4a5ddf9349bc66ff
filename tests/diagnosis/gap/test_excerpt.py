"""Long recordings are looked at in windows of equal length, spread evenly; short ones as they are."""

from __future__ import annotations

import numpy as np
import pytest
from cases import case_of

from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.excerpt import excerpt, folds_of
from gapscope.diagnosis.thresholds import EXAMINED, LEAST_WINDOW, MOST_FOLDS, WINDOW
from gapscope.envs.mystery_arm import iiwa
from gapscope.model.conditioning import condition, pieces

RATE = 50.0


def recording(seconds: float, name: str = "long.csv") -> Recording:
    t = np.arange(int(seconds * RATE)) / RATE
    phases = np.arange(7)
    q = np.sin(0.7 * t[:, None] + phases)
    return Recording(name, t, q, np.cos(0.7 * t[:, None] + phases))


def test_a_minute_is_looked_at_as_it_is() -> None:
    whole = case_of("long", iiwa(), recording(60.0))
    assert excerpt(whole) is whole


def test_an_hour_is_looked_at_in_every_part() -> None:
    whole = recording(3600.0)
    seen = excerpt(case_of("long", iiwa(), whole)).recordings[0]
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


def test_of_many_recordings_each_has_its_window() -> None:
    seen = excerpt(
        case_of("long", iiwa(), *(recording(20.0, f"{k}.csv") for k in range(20)))
    ).recordings
    assert [r.name for r in seen] == [f"{k}.csv" for k in range(20)]
    assert sum(len(r.t) for r in seen) / RATE == pytest.approx(EXAMINED, rel=0.05)


def test_of_too_many_recordings_some_are_looked_at_from_first_to_last() -> None:
    seen = excerpt(
        case_of("long", iiwa(), *(recording(10.0, f"{k}.csv") for k in range(100)))
    ).recordings
    assert len(seen) == EXAMINED / LEAST_WINDOW
    assert (seen[0].name, seen[-1].name) == ("0.csv", "99.csv")


@pytest.mark.parametrize("seconds", [[60.0], [3600.0], [10.0] * 5, [8.0] * 20])
def test_folds_hold_every_segment_and_are_few(seconds: list[float]) -> None:
    names = [recording(s, f"{k}.csv") for k, s in enumerate(seconds)]
    segments = [
        condition(r, 10.0) for r in excerpt(case_of("long", iiwa(), *names)).recordings
    ]
    folds = folds_of(segments)
    assert min(4, len(folds)) <= len(folds) <= MOST_FOLDS
    rows = sum(len(s.motion.t[s.inner]) for fold in folds for s in fold)
    assert rows == sum(len(s.motion.t[s.inner]) for some in segments for s in some)
