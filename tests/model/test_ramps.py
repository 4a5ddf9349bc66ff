"""The likeliest even change of a torque: against its formula, and on what changes at once."""

import numpy as np
import pytest

from gapscope.model.ramps import best_ramp

T = np.arange(0.0, 12.0, 0.03)
TORQUE = 1.5 + np.sin(2.1 * T)


def ramp(changed: np.ndarray, noise: float):
    rng = np.random.default_rng(4)
    r = changed * TORQUE + noise * rng.standard_normal(len(T))
    right, square = r * TORQUE / noise**2, TORQUE**2 / noise**2
    return best_ramp(T, right, square, 0.3, 0.95), right, square


@pytest.mark.parametrize(("begin", "end"), [(2.0, 9.0), (5.0, 6.0), (3.3, 4.1)])
def test_it_is_placed_and_sized(begin: float, end: float) -> None:
    risen = 0.8 * np.clip((T - begin) / (end - begin), 0.0, 1.0)
    found, right, square = ramp(risen, 0.1)
    assert found is not None
    assert found.begins[0] <= begin <= found.begins[1]
    assert found.end == pytest.approx(end, abs=0.3)
    assert found.share == pytest.approx(0.8, rel=0.05)
    assert found.mean > found.at_once
    w = np.clip((T - found.begin) / (found.end - found.begin), 0.0, 1.0)
    explained = (w @ right) ** 2 / (2 * w**2 @ square)
    assert found.explained == pytest.approx(explained)


def test_what_changes_at_once_is_likelier_at_once() -> None:
    found, *_ = ramp(0.8 * (T >= 5.0), 0.1)
    assert found is not None and found.at_once > found.mean


def test_a_recording_shorter_than_a_ramp_has_none() -> None:
    short = T[:8]
    assert best_ramp(short, short, short, 0.3, 0.95) is None
