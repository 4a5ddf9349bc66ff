"""The sampling rate of a recording, from stamps that need not be even."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.recording import Recording


def rate(steps: list[float]) -> float:
    t = np.cumsum([0.0, *steps])
    return Recording("a.csv", t, np.zeros((len(t), 1))).rate


def test_rate_is_that_of_the_usual_steps() -> None:
    assert rate([0.004] * 20 + [0.5]) == pytest.approx(250.0)


def test_steps_of_two_kinds_have_a_rate() -> None:
    # as many of each: the median lies between them, far from both
    assert rate([0.02, 0.02, 0.5, 0.5]) == pytest.approx(1 / 0.26, rel=0.01)
