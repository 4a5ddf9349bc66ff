"""What the search looks at: all of short logs, and of long ones as much, from everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.selection.searched_folds import searched_folds
from gapscope.diagnosis.thresholds import SEARCH_DURATION
from gapscope.ident.signals.conditioning import Segment

RATE = 100.0


def segment(seconds: float, start: float = 0.0) -> Segment:
    t = start + np.arange(int(seconds * RATE) + 1) / RATE
    q = np.sin(t)[:, None]
    return Segment("log", Motion(t, q, np.cos(t)[:, None], -q), torque=q)


def seconds_of(folds: list[list[Segment]]) -> float:
    return sum(float(s.motion.t[-1] - s.motion.t[0]) for f in folds for s in f)


def test_a_short_log_is_looked_at_as_it_is() -> None:
    folds = [[segment(20.0)], [segment(30.0), segment(5.0, start=40.0)]]
    looked_at = searched_folds(folds)
    assert [len(fold) for fold in looked_at] == [1, 2]
    assert seconds_of(looked_at) == pytest.approx(55.0)


@pytest.mark.parametrize("minutes", [20, 120])
def test_of_a_long_log_as_much_is_looked_at_however_long_it_is(minutes: int) -> None:
    (fold,) = searched_folds([[segment(60.0 * minutes)]])
    assert seconds_of([fold]) == pytest.approx(SEARCH_DURATION, rel=0.15)
    starts = np.array([s.motion.t[0] for s in fold])
    steps = np.diff(starts)
    assert steps.max() < 1.6 * steps.min()
    assert starts[0] < 60.0 * minutes / 10
    middle = 30.0 * minutes
    assert (starts < middle).sum() == (starts >= middle).sum()


def test_folds_keep_their_places_and_their_share() -> None:
    folds = [[segment(600.0)], [segment(1800.0)], [segment(15.0)]]
    looked_at = searched_folds(folds)
    lengths = [seconds_of([fold]) for fold in looked_at]
    assert lengths[1] / lengths[0] == pytest.approx(3.0, rel=0.3)
    assert lengths[2] == pytest.approx(15.0)
