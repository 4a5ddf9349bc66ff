"""Files of one log have one time; logs of their own do not."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.io.load_recording import joined_in_time
from gapscope.arm.recording import Recording


def log(begun: float, rows: int = 100) -> Recording:
    return Recording("log", np.arange(rows) / 100, np.zeros((rows, 1)), begun=begun)


@pytest.mark.parametrize("start", [0.0, 1e5, 1.79e9])
def test_time_goes_on_over_the_files_of_one_log(start: float) -> None:
    files = [log(start + 1.0), log(start), log(start + 2.0)]
    second, first, third = joined_in_time(files)
    assert [one.begun for one in (first, second, third)] == [start] * 3
    assert first.t[0] == 0.0
    assert second.t[0] == pytest.approx(1.0, abs=1e-6)
    assert third.t[-1] == pytest.approx(2.99, abs=1e-6)
    for before, after in zip(files, (second, first, third), strict=True):
        np.testing.assert_allclose(before.stamps, after.stamps, rtol=0, atol=1e-6)


def test_two_logs_that_were_split_alike() -> None:
    """Both clocks begin at zero, as those of many loggers do."""
    parts = [log(0.0), log(1.0, 50), log(0.0, 120), log(1.2, 50)]
    times = [one.t[0] for one in joined_in_time(parts)]
    assert times == pytest.approx([0.0, 1.0, 0.0, 1.2])


def test_other_logs_have_a_time_of_their_own() -> None:
    """Logs that begin at zero, one a minute later, and one that began before the other ended."""
    for begun in (0.0, 60.0, 0.5):
        one, other = joined_in_time([log(0.0), log(begun)])
        assert one.t[0] == other.t[0] == 0.0
